"""What is installed for the engine, and with which programs. No bpy.

The packages and their versions are in pyproject.toml alone, which is part of the extension.
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .command import ISOLATED
from .python import SOURCE, environment_python

OPTIONAL = ("video", "heic", "masks")
"""Extras of the project that not every platform has wheels for."""
FORMATS = "formats"
"""The extra of `Plan.formats`."""
DOWNLOAD_BYTES, DISK_BYTES = 411e6, 1_260e6
"""What a set-up for the CPU takes, measured with torch 2.13 and Python 3.11 on Linux (x86-64)."""
CUDA_DOWNLOAD_BYTES = 2.6e9
"""What torch 2.13 for CUDA 13.0 takes instead, on Linux: as others have reported, not measured."""
FORMATS_DOWNLOAD_BYTES, FORMATS_DISK_BYTES = 125e6, 520e6
"""What `Plan.formats` adds."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What to install and from where.

    Attributes:
        environments: folders of earlier ones; the new one is made in the first.
        torch_index: where torch comes from, for an NVIDIA GPU; empty: torch for the CPU.
        formats: also what **Export** and **Import** need for other formats than PLY.
        wheels: folder to install from, without a network; None: PyPI and PyTorch's index.
    """

    environments: tuple[Path, ...]
    torch_index: str = ""
    formats: bool = True
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
    needed: bool = True
    """Whether the environment is of no use if it fails."""


def _project() -> dict[str, Any]:
    text = (SOURCE / "pyproject.toml").read_text(encoding="utf-8")
    found: dict[str, Any] = tomllib.loads(text)["project"]
    return found


def requirements(*extras: str) -> list[str]:
    """What training needs, and the given extras of the project, as pip expects it."""
    project = _project()
    optional = project["optional-dependencies"]
    return [
        *project["dependencies"],
        *(needed for extra in ("train", *extras) for needed in optional[extra]),
    ]


def name_of(package: str) -> str:
    """The name of what pip is asked for, without its version."""
    return re.split(r"[<>=!~;\[ ]", package)[0]


def steps(plan: Plan, base: Path, environment: Path) -> list[Step]:
    """The programs that make `environment` with the Python `base`."""
    python = str(environment_python(environment))
    runs = [python, ISOLATED]
    pip = [*runs, "-m", "pip", "install", "--no-input", "--disable-pip-version-check"]
    wanted = requirements()
    venv = [str(base), ISOLATED, "-m", "venv", str(environment)]
    make = Step(title="Creating the environment", command=venv)
    finish = [
        Step(title="Removing what is not needed", command=[*runs, _script("trim_engine")]),
        Step(title="Testing the environment", command=[*runs, _script("try_engine")]),
    ]
    if plan.wheels is not None:
        source = ["--no-index", "--find-links", str(plan.wheels)]
        install = Step(title="Installing", command=[*pip, *source, *wanted])
        return [make, install, *_optional([*pip, *source], plan), *finish]
    index = ["--index", plan.torch_index] if plan.torch_index else []
    torch = [*runs, _script("install_torch"), *index]
    return [
        make,
        # From this version on, pip reports how much of a file it has.
        Step(title="Updating pip", command=[*pip, "pip>=24.1"]),
        Step(title="Installing torch", command=torch),
        Step(title="Installing the rest", command=[*pip, *wanted]),
        *_optional(pip, plan),
        *finish,
    ]


def _optional(pip: list[str], plan: Plan) -> list[Step]:
    """What the engine also works without: one for each package, as some have no wheel here.

    They are never compiled.
    """
    extras = _project()["optional-dependencies"]
    return [
        Step(
            title=f"Installing {name_of(package)}",
            command=[*pip, "--only-binary", ":all:", package],
            needed=False,
        )
        for extra in (*OPTIONAL, *([FORMATS] if plan.formats else []))
        for package in extras[extra]
    ]


def _script(name: str) -> str:
    return str(SOURCE / "tools" / f"{name}.py")
