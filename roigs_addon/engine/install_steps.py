"""What is installed for the engine, and with which programs. No bpy.

The packages and their versions are in pyproject.toml alone, which is part of the extension.
"""

from __future__ import annotations

import platform
import tomllib
from dataclasses import dataclass
from pathlib import Path

from .python import SOURCE, environment_python

CUDA_INDEX = "https://download.pytorch.org/whl/cu130"
DOWNLOAD_BYTES, DISK_BYTES = 435e6, 1480e6
"""What a set-up for the CPU takes, measured with torch 2.13 and Python 3.11 on Linux (x86-64).

125e6 and 520e6 of it are for file formats."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What to install and from where.

    Attributes:
        environments: folders of earlier ones; the new one is made in the first.
        cuda: torch for NVIDIA GPUs instead of the one for the CPU, and gsplat.
        wheels: folder to install from, without a network; None: PyPI and PyTorch's index.
    """

    environments: tuple[Path, ...]
    cuda: bool = False
    wheels: Path | None = None


@dataclass(frozen=True, kw_only=True)
class Step:
    """One program that runs to its end.

    Attributes:
        title, command: of it.
        optional: the engine works without it; if it fails, the set-up goes on.
    """

    title: str
    command: list[str]
    optional: bool = False


def requirements(*extras: str) -> list[str]:
    """What training needs, and the given extras of the project, as pip expects it."""
    project = tomllib.loads((SOURCE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    optional = project["optional-dependencies"]
    return [
        *project["dependencies"],
        *(needed for extra in ("train", *extras) for needed in optional[extra]),
    ]


def format_packages() -> list[str]:
    """What **Export** and **Import** need for other formats than PLY, as pip expects it."""
    project = tomllib.loads((SOURCE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return list(project["optional-dependencies"]["formats"])


def steps(plan: Plan, base: Path, environment: Path) -> list[Step]:
    """The programs that make `environment` with the Python `base`."""
    python = str(environment_python(environment))
    pip = [python, "-m", "pip", "install", "--no-input", "--disable-pip-version-check"]
    cuda = plan.cuda and platform.system() != "Darwin"
    wanted = requirements(*(["cuda"] if cuda else []))
    make = Step(
        title="Creating the environment", command=[str(base), "-m", "venv", str(environment)]
    )
    keep = ["--keep-headers"] if cuda else []  # gsplat compiles with them
    finish = [
        Step(title="Removing what is not needed", command=[python, _script("trim_engine"), *keep]),
        Step(title="Testing the environment", command=[python, _script("try_engine")]),
    ]
    if plan.wheels is not None:
        source = ["--no-index", "--find-links", str(plan.wheels)]
        install = Step(title="Installing", command=[*pip, *source, *wanted])
        return [make, install, *_formats([*pip, *source]), *finish]
    index = ["--index", CUDA_INDEX] if cuda else []
    torch = [python, _script("install_torch"), *index]
    return [
        make,
        # From this version on, pip reports how much of a file it has.
        Step(title="Updating pip", command=[*pip, "pip>=24.1"]),
        Step(title="Installing torch", command=torch),
        Step(title="Installing the rest", command=[*pip, *wanted]),
        *_formats(pip),
        *finish,
    ]


def _formats(pip: list[str]) -> list[Step]:
    """One for each package: some systems have wheels for a part of them only."""
    return [
        Step(title=f"Installing {package}", command=[*pip, package], optional=True)
        for package in format_packages()
    ]


def _script(name: str) -> str:
    return str(SOURCE / "tools" / f"{name}.py")
