"""Description of a job: its command, and the use of its results. No bpy."""

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
"""Titles of jobs. Each step of the panel shows the progress and the error of its own job."""

RESUMED = {
    TRAINING: "Continue",
    RECONSTRUCTING: "Continue",
    LEVELS: "Make Levels",
    SURFACES: "Make Surface",
}
"""Jobs that keep their progress when they stop -> the button that resumes them."""


def how_to_resume(title: str) -> str:
    """Return a sentence on how to resume a job, to append; empty for jobs that start over."""
    return f" Click '{RESUMED[title]}' to resume." if title in RESUMED else ""


def nothing(*_: object) -> None:
    """Do nothing; the default of callbacks."""


def always() -> bool:
    """Return True; the default of `is_so`."""
    return True


@dataclass(frozen=True, kw_only=True)
class JobSpec:
    """An engine command, and the use of its results.

    Attributes:
        title: name of the job in the panel.
        arguments: the engine's command line, beginning with the command.
        log: file of the engine's log.
        folder: of the run; previews outside it are ignored.
        on_preview: called with the path of each preview.
        on_done: called after a job that finished and was not stopped; may raise AddonError. If it
            returns a line, it replaces `done_text`.
        on_stop: called after a job that was stopped or failed, to take finished results.
        changes: whether the callback at the end changes the scene. If so, it gets an undo step.
        then: called with the engine's outputs (name -> path) after a command that finished and was
            not stopped. Returns the job's next command, or None; may raise AddonError.
        done_text: message to the user after the job; empty where the window shows the result.
        is_so: whether `done_text` still holds; a panel asks this, for example after an undo.
        words: option of the command -> its name in the panel, for the engine's errors.
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
