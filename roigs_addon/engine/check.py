"""Lists which tasks the engine can do, and which packages are missing. No bpy."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ..shared import files
from . import install_steps, python


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One line: a task and whether it works here, or a Python and its path."""

    works: bool
    text: str


TASKS = (
    ("Reading models", python.FOR_READING),
    ("Refining cameras", python.FOR_REFINING),
    ("Selecting photos", python.FOR_READING),
    ("Selecting by Gaussian process", python.FOR_GAUSSIAN_PROCESS),
    ("Training and rendering", python.FOR_TRAINING),
    ("Photos with lens distortion", python.FOR_DISTORTION),
    ("Scenes from photos", python.FOR_RECONSTRUCTING),
    ("Scenes from videos", python.FOR_VIDEOS),
    ("Scenes from HEIC photos", python.FOR_HEIC),
    ("Masks from strokes", python.FOR_MASKS),
    ("Surfaces as meshes", python.FOR_SURFACES),
)

last: tuple[Finding, ...] = ()
"""What the last `check` found, for the preferences page: a check takes too long for drawing."""


def check(chosen: str, environments: Iterable[Path]) -> tuple[Finding, ...]:
    """Check every candidate Python again.

    Args:
        chosen: Python named by the user, or empty.
        environments: folders of the environments made by 'Set Up the Engine'.
    """
    global last
    python.ability.cache_clear()
    there = python.candidates(chosen, environments)
    used: list[Path] = []
    findings = []
    for task, packages in TASKS:
        able = [path for path in there if not python.ability(path).lacks(packages)]
        path = (able or there)[0]
        used += [path] if path not in used else []
        says = "ready" if able else f"not ready: {_lack(path, packages)}"
        findings.append(Finding(works=bool(able), text=f"{task}: {says}"))
    last = (*findings, *(_place(path) for path in used))
    return last


def _lack(path: Path, packages: tuple[str, ...]) -> str:
    ability = python.ability(path)
    reason = ability.lacks(packages)
    return reason if ability.fault else reason.replace("it lacks", f"{_name(path)} lacks")


def _place(path: Path) -> Finding:
    problem = python.ability(path).fault or _outdated(path)
    return Finding(works=not problem, text=f"{_name(path)}: {path}{problem and f', {problem}'}")


def _outdated(path: Path) -> str:
    """Return why a Python of 'Set Up the Engine' does not fit this version of the add-on."""
    wanted = files.read_record(path.parent.parent / python.MARKER).get("requirements")
    made_for_this = wanted in (None, install_steps.requirements())
    return "" if made_for_this else "made for other versions of packages; set up the engine again"


def _name(path: Path) -> str:
    ability = python.ability(path)
    return "Python" if ability.fault else "Python {}.{}".format(*ability.version)


def forget() -> None:
    """Drop the findings."""
    global last
    last = ()
