"""Packages to install for the engine, and the programs that install them. No bpy.

The packages are only in pyproject.toml, which is part of the extension. The versions and hashes of
downloads are in tools/locked/; tools/lock_packages.py makes them from pyproject.toml.
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .command import ISOLATED
from .python import SOURCE, environment_python

OPTIONAL = ("video", "heic", "masks", "surface", "gpu")
"""Extras of the project without wheels for every platform."""
PIP, ENGINE = "pip", "engine"
"""Files of tools/locked/ beside those of the optional packages."""
FORMATS = "formats"
"""The extra of `Plan.formats`."""
ONLY_WHEELS = ("--only-binary", ":all:")
DOWNLOAD_BYTES, DISK_BYTES = 431e6, 1_311e6
"""Size of a set-up for the CPU, measured with torch 2.13 and Python 3.11 on Linux (x86-64)."""
CUDA_DOWNLOAD_BYTES = 2.6e9
"""Size with torch 2.13 for CUDA 13.0 instead, on Linux: as reported by others, not measured."""
FORMATS_DOWNLOAD_BYTES, FORMATS_DISK_BYTES = 125e6, 520e6
"""Additional size of `Plan.formats`."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The packages to install, and their source.

    Attributes:
        environments: folders of environments; the new one is made in the first folder.
        torch_index: package index of torch for an NVIDIA GPU; empty for torch for the CPU.
        formats: also install packages for **Export** and **Import** of formats other than PLY.
        wheels: folder to install from, without a network; None for PyPI and PyTorch's index.
    """

    environments: tuple[Path, ...]
    torch_index: str = ""
    formats: bool = True
    wheels: Path | None = None


@dataclass(frozen=True, kw_only=True)
class Step:
    """One program that runs to its end.

    Attributes:
        title: for the user.
        command: of the program.
        needed: if not, the engine works without it, and the set-up continues if it fails.
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
    """Return the requirements of training and of the project's given extras, for pip."""
    project = _project()
    optional = project["optional-dependencies"]
    return [
        *project["dependencies"],
        *(needed for extra in ("train", *extras) for needed in optional[extra]),
    ]


def name_of(package: str) -> str:
    """Return the name in a requirement, without its version."""
    return re.split(r"[<>=!~;\[ ]", package)[0]


def steps(plan: Plan, base: Path, environment: Path) -> list[Step]:
    """Return the steps that make `environment` with the Python `base`."""
    python = str(environment_python(environment))
    runs = [python, ISOLATED]
    pip = [*runs, "-m", "pip", "install", "--no-input", "--disable-pip-version-check"]
    venv = [str(base), ISOLATED, "-m", "venv", str(environment)]
    make = Step(title="Creating the environment", command=venv)
    optional = optional_packages(formats=plan.formats)
    finish = [
        Step(title="Removing unneeded files", command=[*runs, _script("trim_engine")]),
        Step(title="Testing the environment", command=[*runs, _script("try_engine")]),
    ]
    if plan.wheels is not None:
        pip += ["--no-index", "--find-links", str(plan.wheels)]
        install = Step(title="Installing", command=[*pip, *requirements()])
        more = [_optional(package, [*pip, *ONLY_WHEELS, package]) for package in optional]
        return [make, install, *more, *finish]
    index = ["--index", plan.torch_index] if plan.torch_index else []
    torch = [*runs, _script("install_torch"), *index]
    return [
        make,
        # From 24.1 on, pip reports the progress of a download.
        Step(title="Updating pip", command=[*pip, *_locked(PIP)]),
        # Before torch: then torch's requirements are installed, except those for a graphics card.
        Step(title="Installing packages", command=[*pip, *_locked(ENGINE)]),
        Step(title="Installing torch", command=torch),
        *(_optional(package, [*pip, *_locked(name_of(package))]) for package in optional),
        *finish,
    ]


def optional_packages(*, formats: bool) -> list[str]:
    """Return the packages that the engine can do without; some lack wheels for a platform."""
    extras = _project()["optional-dependencies"]
    return [
        package
        for extra in (*OPTIONAL, *([FORMATS] if formats else []))
        for package in extras[extra]
    ]


def _optional(package: str, command: list[str]) -> Step:
    return Step(title=f"Installing {name_of(package)}", command=command, needed=False)


def _locked(name: str) -> list[str]:
    """Return pip's arguments: only the versions and hashes of a file, and only wheels."""
    path = SOURCE / "tools" / "locked" / f"{name}.txt"
    return ["--require-hashes", "--no-deps", *ONLY_WHEELS, "--requirement", str(path)]


def _script(name: str) -> str:
    return str(SOURCE / "tools" / f"{name}.py")
