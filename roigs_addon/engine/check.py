"""Says what works and what is missing, job by job. No bpy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from . import python
from .client import Engine


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One job: whether it can be done, and by which Python, or what is missing."""

    works: bool
    text: str


JOBS = (
    ("Reading models", python.FOR_READING),
    ("Selecting photos", python.FOR_READING),
    ("Selecting by Gaussian process", python.FOR_GAUSSIAN_PROCESS),
    ("Training and rendering", python.FOR_TRAINING),
    ("Photos with lens distortion", python.FOR_DISTORTION),
)

last: tuple[Finding, ...] = ()
"""What the last `check` found, for the preferences page: asking takes too long to be drawn."""


def check(chosen: str, home: Path) -> tuple[Finding, ...]:
    """Ask every candidate afresh.

    Args:
        chosen: Python named by the user, or empty.
        home: folder of the environments that «Set up the engine» makes.
    """
    global last
    python.ability.cache_clear()
    last = tuple(_finding(job, packages, chosen, home) for job, packages in JOBS)
    return last


def _finding(job: str, packages: tuple[str, ...], chosen: str, home: Path) -> Finding:
    engine, reason = python.find(chosen, home, packages)
    if engine is None:
        return Finding(works=False, text=f"{job}: not yet. {reason}")
    return Finding(works=True, text=f"{job}: ready, {_described(engine)}")


def _described(engine: Engine) -> str:
    major, minor = python.ability(engine.python).version
    return f"Python {major}.{minor} ({engine.python})"


def forget() -> None:
    """Drop what was found."""
    global last
    last = ()
