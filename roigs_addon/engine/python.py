"""Finds the Python that runs the engine, and its packages. No bpy."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ..shared import files
from .command import HIDDEN, ISOLATED, Engine, variables

SOURCE = Path(__file__).resolve().parents[2]
"""The folder with `roigs_engine`: that of the extension."""

VARIABLE = "ROIGS_ENGINE_PYTHON"
"""Environment variable that names the engine's Python: for tests and render farms."""

FOR_MESHES = ("fast_simplification", "skimage", "trimesh")
PACKAGES = (
    *("numpy", "PIL", "scipy", "sklearn", "pycolmap", "torch", "av", "pillow_heif", "cv2"),
    *FOR_MESHES,
)
FOR_READING = ("numpy",)
FOR_GAUSSIAN_PROCESS = ("numpy", "scipy", "sklearn")
FOR_REFINING = ("numpy", "PIL", "scipy", "sklearn", "pycolmap")
FOR_PICTURES = ("numpy", "PIL")
FOR_SUGGESTING = ("numpy", "PIL", "scipy")
FOR_DISTORTION = ("numpy", "PIL", "pycolmap")
FOR_RECONSTRUCTING = ("numpy", "PIL", "pycolmap")
FOR_VIDEOS = (*FOR_RECONSTRUCTING, "av")
FOR_HEIC = (*FOR_RECONSTRUCTING, "pillow_heif")
FOR_TRAINING = ("numpy", "PIL", "scipy", "torch")
FOR_MASKS = (*FOR_TRAINING, "cv2")
FOR_SURFACES = (*FOR_TRAINING, *FOR_MESHES)

MARKER = "roigs-complete.json"
"""File in a complete environment, with its requirements."""

OLDEST = (3, 11)
PROBE_SECONDS = 60.0

_PROBE = (
    "import importlib.util as u, json, sys;"
    "print(json.dumps({'version': list(sys.version_info[:2]),"
    f" 'packages': [n for n in {PACKAGES!r} if u.find_spec(n)]}}))"
)


@dataclass(frozen=True, kw_only=True)
class Ability:
    """Version and packages of a Python.

    Attributes:
        version: (major, minor); (0, 0) if it does not start.
        missing: packages of PACKAGES that it lacks.
        fault: why it does not start; empty if it does.
    """

    version: tuple[int, int]
    missing: tuple[str, ...]
    fault: str = ""

    def lacks(self, packages: tuple[str, ...]) -> str:
        """Return why this Python cannot be used, as a phrase; empty if it can."""
        if self.fault:
            return self.fault
        if self.version < OLDEST:
            return f"it is Python {self.version[0]}.{self.version[1]}; 3.11 or later is needed"
        missing = [name for name in packages if name in self.missing]
        return f"it lacks {', '.join(missing)}" if missing else ""


@functools.lru_cache(maxsize=32)
def ability(python: Path) -> Ability:
    """Start a Python once to find its abilities; call `ability.cache_clear()` after installing."""
    if not python.is_absolute():
        return _faulty("it is not a full path; choose the program again")
    try:
        result = subprocess.run(
            [str(python), ISOLATED, "-c", _PROBE],
            capture_output=True,
            text=True,
            timeout=PROBE_SECONDS,
            env=variables(),
            cwd=SOURCE,
            check=False,
            creationflags=HIDDEN,
        )
        found = json.loads(result.stdout.strip().splitlines()[-1])
        version = (int(found["version"][0]), int(found["version"][1]))
        there = set(found["packages"])
    except OSError as error:
        return _faulty(f"it does not start ({error.strerror or error})")
    except subprocess.TimeoutExpired:
        return _faulty(f"it does not answer within {PROBE_SECONDS:.0f} seconds")
    except (ValueError, KeyError, IndexError):
        return _faulty("it is not a working Python")
    return Ability(version=version, missing=tuple(n for n in PACKAGES if n not in there))


def _faulty(fault: str) -> Ability:
    return Ability(version=(0, 0), missing=PACKAGES, fault=fault)


def own_python() -> Path:
    """Return Blender's own Python as a program."""
    own = Path(sys.executable)
    if "python" in own.name.lower():
        return own
    folder = Path(sys.prefix) / ("" if os.name == "nt" else "bin")
    names = ["python.exe"] if os.name == "nt" else [f"python3.{sys.version_info[1]}", "python3"]
    return next((folder / n for n in names if (folder / n).is_file()), own)


def environment_python(environment: Path) -> Path:
    """Return the Python of a virtual environment."""
    if os.name == "nt":
        return environment / "Scripts" / "python.exe"
    return environment / "bin" / "python"


def complete_environments(folders: Iterable[Path]) -> list[Path]:
    """Return the complete environments in some folders: folder by folder, the newest first."""
    return [path for folder in folders for path in _newest_first(folder)]


def _newest_first(folder: Path) -> list[Path]:
    marked = (path.parent for path in files.matching(folder, f"*/{MARKER}"))
    found = [path for path in marked if path.name.isdecimal()]
    return sorted(found, key=lambda path: int(path.name), reverse=True)


def candidates(chosen: str, environments: Iterable[Path]) -> list[Path]:
    """Return Pythons to try, in order of preference; only one if the user named it.

    Args:
        chosen: Python named by the user, or empty.
        environments: folders of the environments made by 'Set Up the Engine'.
    """
    named = chosen or os.environ.get(VARIABLE, "")
    if named:
        # Blender writes `//` for the .blend's folder, where an untrusted program may be.
        return [Path(named.lstrip("/") if named.startswith("//") else named)]
    made = [environment_python(environment) for environment in complete_environments(environments)]
    return [*made, own_python()]


def find(
    chosen: str, environments: Iterable[Path], packages: tuple[str, ...]
) -> tuple[Engine | None, str]:
    """Find the first Python that has the packages, or explain why there is none.

    Returns:
        The engine, or None and a sentence for the user.
    """
    reasons = []
    for python in candidates(chosen, environments):
        reason = ability(python).lacks(packages)
        if not reason:
            return Engine(python=python, source=SOURCE), ""
        reasons.append(f"{python}: {reason}")
    return None, f"No Python can run the engine ({'; '.join(reasons)})."
