"""`rois.json` (docs/files.md): boxes for engine and add-on; numpy only."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..errors import RoiError
from .files import read_json
from .names import MAX_NAME, first_taken, is_file_name
from .transforms import is_mirrored, numbers, rigid_flaw

Float64 = NDArray[np.float64]
NAME_HINT = (
    f"Rename the box: at most {MAX_NAME} letters, digits, spaces, - and _; no space or dot at the"
    " ends, and no name that Windows reserves (NUL, CON, COM1)."
)
FORM_HINT = "Give 'min' and 'max' with 3 numbers each, or 'world_to_box' and 'half_extents'."
FILE_HINT = 'Give --rois a JSON file with a list "rois" of {"name", "min", "max"}.'
ENDINGS = (".compressed", ".surface")
"""Suffixes after a box's name in some of its files, such as `vase.surface.ply`."""
MOST_BOXES = 500  # in a file or a run; each box is compared with each photo
FAR = 1e15  # world units; larger coordinates come from damaged files and overflow in float32


@dataclass(frozen=True, kw_only=True, eq=False)
class RoiRecord:
    """One box of the file."""

    name: str  # unique within a file; used in file names
    world_to_box: Float64  # (4, 4) rigid transform from the COLMAP frame; the centre maps to 0
    half_extents: Float64  # (3,) half side lengths, world units

    def __post_init__(self) -> None:
        _check_box(self.name, self.world_to_box, self.half_extents)

    @classmethod
    def between(cls, name: str, low: Any, high: Any) -> Self:
        """The box between two corners, (3,) each, along the axes of the COLMAP frame."""
        low_, high_ = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        transform = np.eye(4)
        with np.errstate(all="ignore"):  # the check below refuses overflow, too
            transform[:3, 3] = -(low_ + high_) / 2
            return cls(name=name, world_to_box=transform, half_extents=(high_ - low_) / 2)

    def to_dict(self) -> dict[str, Any]:
        """The form that `roi_record` reads."""
        return {
            "name": self.name,
            "world_to_box": self.world_to_box.tolist(),
            "half_extents": self.half_extents.tolist(),
        }


def check_roi_name(name: str) -> str:
    """Return the name; RoiError if files cannot have it on every system."""
    if not is_file_name(name):
        raise RoiError(f"'{name:.{MAX_NAME}}' cannot name a file.", NAME_HINT)
    if name.casefold().endswith(ENDINGS):
        raise RoiError(
            f"'{name}' cannot name a box: files of other boxes end so.",
            f"Rename the box, without {' or '.join(ENDINGS)} at the end.",
        )
    return name


def _check_box(name: str, world_to_box: Float64, half_extents: Float64) -> None:
    """Raise RoiError if the numbers are not a valid box."""
    values = np.concatenate([world_to_box.ravel(), half_extents])
    if not (np.abs(values) < FAR).all():  # catches NaN too
        raise RoiError(
            f"Box '{name}' has a number that is NaN, Inf or too large.",
            f"Use numbers below {FAR:g}, in the frame of the COLMAP model.",
        )
    flaw = rigid_flaw(world_to_box)
    if flaw:
        raise RoiError(
            f"Box '{name}': world_to_box is not a rotation and a translation: {flaw}.",
            "Put the box's size into half_extents, and the translation into the last column.",
        )
    if not (half_extents > 0).all():
        sides = " x ".join(f"{2 * side:g}" for side in half_extents)
        raise RoiError(
            f"Box '{name}' is empty: its sides are {sides}.",
            "Make every side longer than zero (min < max).",
        )


def roi_record(record: Any) -> RoiRecord:
    """Read a box from `{"name", "min", "max"}` or `{"name", "world_to_box", "half_extents"}`.

    The first axis of a mirrored `world_to_box` is reversed; the volume stays the same.
    RoiError: a key is missing, a value has the wrong shape, or the matrix is not rigid.
    """
    if not isinstance(record, dict) or not isinstance(record.get("name"), str):
        raise RoiError("A box must be an object with a 'name' and 'min'/'max' corners.", FORM_HINT)
    name = check_roi_name(record["name"])
    if "min" in record and "world_to_box" in record:
        raise RoiError(f"Box '{name}' has both 'min' and 'world_to_box'.", FORM_HINT)
    try:
        if "min" in record:
            low, high = (numbers(record[key], (3,), key) for key in ("min", "max"))
            return RoiRecord.between(name, low, high)
        transform = numbers(record["world_to_box"], (4, 4), "world_to_box")
        half_extents = numbers(record["half_extents"], (3,), "half_extents")
    except KeyError as error:
        raise RoiError(f"Box '{name}' has no {error}.", FORM_HINT) from error
    except (ValueError, OverflowError) as error:
        raise RoiError(f"Box '{name}': {error}.", FORM_HINT) from error
    with np.errstate(all="ignore"):  # huge numbers are refused below
        if is_mirrored(transform):
            transform[0] *= -1
    return RoiRecord(name=name, world_to_box=transform, half_extents=half_extents)


def refuse_many(count: int) -> None:
    """Raise RoiError for more than `MOST_BOXES` boxes."""
    if count > MOST_BOXES:
        raise RoiError(
            f"There are {count:,} boxes; at most {MOST_BOXES} are used.", "Remove some of them."
        )


def read_rois(path: Path) -> list[RoiRecord]:
    """All boxes of a `rois.json`: `{"rois": [...]}` or a bare list.

    RoiError: the file is unreadable, holds no box or too many, or two boxes share a name.
    """
    document = read_json(path, RoiError, FILE_HINT)
    records = document.get("rois") if isinstance(document, dict) else document
    if not isinstance(records, list) or not records:
        raise RoiError(f"{path} contains no box.", FILE_HINT)
    try:
        refuse_many(len(records))
        rois = [roi_record(record) for record in records]
    except RoiError as error:
        raise RoiError(f"{path}: {error.message}", error.hint) from error
    taken = first_taken(roi.name for roi in rois)
    if taken is not None:
        raise RoiError(f"Two boxes in {path} are named '{taken}'.", "Give each its own name.")
    return rois


def rois_document(rois: Sequence[RoiRecord]) -> str:
    """The text of a `rois.json`."""
    records = [roi.to_dict() for roi in rois]
    return json.dumps({"rois": records}, indent=1, ensure_ascii=False) + "\n"
