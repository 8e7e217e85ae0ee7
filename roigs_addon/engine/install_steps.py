"""What is installed for the engine, and with which programs. No bpy.

The packages and their versions are in pyproject.toml alone, which is part of the extension.
"""

from __future__ import annotations

import platform
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from .python import FOR_TRAINING, SOURCE, environment_python

CUDA_INDEX = "https://download.pytorch.org/whl/cu130"


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What to install and from where.

    Attributes:
        environments: folder for the new one, and of earlier ones.
        cuda: torch for NVIDIA GPUs instead of the one for the CPU, and gsplat.
        wheels: folder to install from, without a network; None: PyPI and PyTorch's index.
        in_use: whether an engine runs, maybe in an older environment; called at the end.
    """

    environments: Path
    cuda: bool = False
    wheels: Path | None = None
    in_use: Callable[[], bool] = lambda: False


@dataclass(frozen=True, kw_only=True)
class Step:
    """One program that runs to its end."""

    title: str
    command: list[str]


def requirements(*extras: str) -> list[str]:
    """What training needs, and the given extras of the project, as pip expects it."""
    project = tomllib.loads((SOURCE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    optional = project["optional-dependencies"]
    return [
        *project["dependencies"],
        *(needed for extra in ("train", *extras) for needed in optional[extra]),
    ]


def steps(plan: Plan, base: Path, environment: Path) -> list[Step]:
    """The programs that make `environment` with the Python `base`."""
    python = str(environment_python(environment))
    pip = [python, "-m", "pip", "install", "--no-input", "--disable-pip-version-check"]
    cuda = plan.cuda and platform.system() != "Darwin"
    wanted = requirements(*(["cuda"] if cuda else []))
    make = Step(
        title="Creating the environment", command=[str(base), "-m", "venv", str(environment)]
    )
    packages = ", ".join(FOR_TRAINING)
    check = Step(
        title="Testing the environment",
        command=[python, "-c", f"import {packages}; print(torch.__version__)"],
    )
    if plan.wheels is not None:
        source = ["--no-index", "--find-links", str(plan.wheels)]
        return [make, Step(title="Installing", command=[*pip, *source, *wanted]), check]
    index = ["--index", CUDA_INDEX] if cuda else []
    torch = [python, str(SOURCE / "tools" / "install_torch.py"), *index]
    return [
        make,
        # From this version on, pip reports how much of a file it has.
        Step(title="Updating pip", command=[*pip, "pip>=24.1"]),
        Step(title="Installing torch", command=torch),
        Step(title="Installing the rest", command=[*pip, *wanted]),
        check,
    ]
