"""Finds the Python that creates the engine's environment. No bpy."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from ..errors import AddonError
from .command import HIDDEN, ISOLATED, variables
from .programs import find_program
from .python import SOURCE, own_python

PYTHONS = ((3, 13), (3, 12), (3, 11), (3, 14))
"""Versions for which torch has wheels, in the order of the search."""

PROBE_SECONDS = 20.0
# Folders with Pythons on macOS that programs started from the Dock do not find.
MAC_FOLDERS = ("/opt/homebrew/bin", "/usr/local/bin")

_PROBE = "import ensurepip, venv, sys; print(*sys.version_info[:2])"


def wheel_versions(folder: Path) -> set[tuple[int, int]]:
    """Return the Python versions of the torch wheels in a folder."""
    tags = (re.search(r"-cp3(\d+)-", wheel.name) for wheel in folder.glob("torch-*.whl"))
    return {(3, int(tag[1])) for tag in tags if tag}


def choose_python(wheels: Path | None = None) -> Path:
    """Return a Python that can make the environment: Blender's own, or another on this computer.

    Raises:
        AddonError: there is none, or the folder has no torch.
    """
    allowed = set(PYTHONS)
    if wheels is not None:
        allowed = wheel_versions(wheels)
        if not allowed:
            raise AddonError(f"{wheels} has no wheel of torch. Choose the folder that has one.")
    for command in _pythons():
        if _version(command) in allowed:
            return _program(command)
    names = " or ".join(f"3.{minor}" for _, minor in sorted(allowed))
    debian = " (on Debian and Ubuntu with python3-venv)" if sys.platform == "linux" else ""
    raise AddonError(f"No suitable Python to make the environment. Install Python {names}{debian}.")


def _pythons() -> Iterator[list[str]]:
    """Yield command lines of Pythons to try."""
    yield [str(own_python())]
    folders = MAC_FOLDERS if sys.platform == "darwin" else ()
    launcher = find_program("py") if os.name == "nt" else None
    names = []
    for major, minor in PYTHONS:
        if launcher:
            yield [str(launcher), f"-{major}.{minor}"]
        names.append(f"python{major}.{minor}")
    for name in (*names, "python3", "python"):
        if found := find_program(name, folders):
            yield [str(found)]


def _version(command: list[str]) -> tuple[int, int]:
    """Return the version of a Python that can make environments; (0, 0) for anything else."""
    try:
        said = _ask(command, _PROBE)
        major, minor = said.split()
        return int(major), int(minor)
    except (OSError, subprocess.SubprocessError, ValueError):
        return 0, 0


def _program(command: list[str]) -> Path:
    """Return the program behind a command such as `py -3.11`."""
    if len(command) == 1:
        return Path(command[0])
    return Path(_ask(command, "import sys; print(sys.executable)"))


def _ask(command: list[str], code: str) -> str:
    result = subprocess.run(
        [*command, ISOLATED, "-c", code],
        capture_output=True,
        text=True,
        timeout=PROBE_SECONDS,
        env=variables(),
        cwd=SOURCE,
        check=True,
        creationflags=HIDDEN,
    )
    return result.stdout.strip()
