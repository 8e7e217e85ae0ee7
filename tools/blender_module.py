"""Blender as a Python module: this Python's, or in an environment of its own, `.venv-blender`.

bpy asks for one version of Python and an old numpy, so it is not put into the engine's environment;
inside Blender it is the same. Where the tests have put it there, it is not fetched a second time.
"""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
HOME = ROOT / ".venv-blender"
VERSION = "4.5.15"
REQUIREMENT = f"bpy=={VERSION}"
PYTHON = (3, 11)
# Packages of Debian and Ubuntu that bpy needs on a Linux without a desktop.
LIBRARIES = (
    "libx11-6 libxext6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libice6 libgl1 libegl1"
)


class NoBlenderError(Exception):
    """bpy is not available here; the text gives the reason, and a remedy."""


def python() -> Path:
    """The Python that has bpy; installs it if necessary.

    Raises:
        NoBlenderError: it cannot be installed.
    """
    if own_version() == VERSION:
        return Path(sys.executable)
    program = HOME / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    complete = HOME / REQUIREMENT
    if complete.exists():
        return program
    if sys.version_info[:2] != PYTHON:
        version = ".".join(map(str, PYTHON))
        raise NoBlenderError(f"{REQUIREMENT} needs Python {version}: make PYTHON=python{version}")
    print(f"Installing {REQUIREMENT} into {HOME.name}.", flush=True)
    make = [sys.executable, "-m", "venv", str(HOME)]
    install = ["-m", "pip", "--disable-pip-version-check", "install", "--quiet", REQUIREMENT]
    for command in (make, [str(program), *install]):
        if subprocess.run(command, check=False).returncode:
            raise NoBlenderError(f"{REQUIREMENT} could not be installed, see above")
    complete.touch()
    return program


def own_version() -> str:
    """The version of this Python's bpy; empty if it has none."""
    try:
        return metadata.version("bpy")
    except metadata.PackageNotFoundError:
        return ""


def working_python() -> Path:
    """The Python that has bpy, after a check that bpy starts.

    Raises:
        NoBlenderError: bpy cannot be installed, or does not start.
    """
    program = python()
    result = subprocess.run(
        [program, "-c", "import bpy"], check=False, capture_output=True, text=True, env=variables()
    )
    if result.returncode:
        said = (result.stderr.strip().splitlines() or [f"status {result.returncode}"])[-1]
        help_text = f"; try: apt install {LIBRARIES}" if sys.platform == "linux" else ""
        raise NoBlenderError(f"bpy does not start ({said}){help_text}")
    return program


def variables() -> dict[str, str]:
    """Environment variables for bpy, without the settings of the user's own Blender."""
    return dict(os.environ) | {"BLENDER_USER_RESOURCES": str(ROOT / ".blender" / "user")}
