"""Description of a job: its command and its use. No bpy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

RECONSTRUCTING, IMPORTING, REFINING = "Reconstructing", "Importing", "Refining"
SELECTING, ESTIMATING = "Selecting", "Estimating"
TRAINING, EXPORTING = "Training", "Exporting"
IMPORTING_GAUSSIANS, FLOATERS = "Importing Gaussians", "Finding Floaters"
CONFIDENCE = "Finding Confidence"
MASKING = "Making Masks"
CHECKING, SUGGESTING = "Checking Photos", "Suggesting Photos"
LEVELS, ADAPTING = "Making Levels", "Adapting"
SURFACES = "Making Surfaces"
STAGING = "Preparing Light and Shadows"
RELIGHTING = "Relighting"
"""Titles of jobs: each step of the panel shows the progress and the error of its own."""

RESUMED = {
    TRAINING: "Continue",
    RECONSTRUCTING: "Continue",
    LEVELS: "Make Levels",
    SURFACES: "Make Surface",
}
"""Jobs that keep what they have done when they stop -> the button that goes on from there."""


def how_to_resume(title: str) -> str:
    """A sentence to follow another one; empty for jobs that begin again."""
    return f" Click '{RESUMED[title]}' to resume." if title in RESUMED else ""


def nothing(*_: object) -> None:
    """The default of callbacks."""


def always() -> bool:
    """The default of `is_so`."""
    return True


@dataclass(frozen=True, kw_only=True)
class JobSpec:
    """An engine command, and what to do with what it makes.

    Attributes:
        title: what the panel calls it.
        arguments: the engine's command line, beginning with the command.
        log: where the engine's text goes.
        folder: of the run; previews outside it are ignored.
        on_preview: called with the path of each preview.
        on_done: called after a job that was finished, not stopped; may raise AddonError. The line
            that it returns replaces `done_text`.
        on_stop: called after a job that was stopped or failed, to take what is finished.
        changes: whether `on_done` changes the scene: then an undo takes that back.
        then: called with the engine's outputs (name -> path) after a command that was finished, not
            stopped; returns the command with which the job goes on, or None if there is none; may
            raise AddonError.
        done_text: the message to the user then; empty where the window shows it anyway.
        is_so: whether the scene still is as `done_text` says: a panel asks, also after an undo.
        words: option of the command -> the panel's name of it, for the engine's errors.
    """

    title: str
    arguments: list[str]
    log: Path
    folder: Path | None = None
    on_preview: Callable[[Path], None] = nothing
    on_done: Callable[[], str | None] = nothing
    on_stop: Callable[[], None] = nothing
    changes: bool = True
    then: Callable[[Mapping[str, str]], JobSpec | None] | None = None
    done_text: str = ""
    is_so: Callable[[], bool] = always
    words: Mapping[str, str] = field(default_factory=dict)
