"""What is wrong with photos before anything is matched, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..formats.text import counted
from .look import Found, Photo

SMALL = 480  # px of the longest side, below which features are few
BLURRED = 0.2  # of the median sharpness
NAMED = 4


def warnings_of(found: Found) -> list[str]:
    """One sentence for each thing that is wrong, usually none."""
    checks = [
        (list(found.unreadable), "cannot be read and {is} left out"),
        (list(found.copies), "{is} a copy of another and {is} left out"),
        (small(found.photos), f"{{is}} smaller than {SMALL} px and may not be placed"),
        (blurred(found.photos), "{is} less sharp than the others and may not be placed"),
    ]
    return [
        f"{counted(len(names), 'photo')} {text.format(**_verb(len(names)))}: {named(names)}."
        for names, text in checks
        if names
    ]


def small(photos: Sequence[Photo]) -> list[str]:
    """Names of the photos that are very small."""
    return [photo.name for photo in photos if max(photo.size) < SMALL]


def blurred(photos: Sequence[Photo]) -> list[str]:
    """Names of the photos with much less detail than is usual among them."""
    usual = float(np.median([photo.sharpness for photo in photos]))
    return [photo.name for photo in photos if photo.sharpness < BLURRED * usual]


def named(names: Sequence[str], most: int = NAMED) -> str:
    """The names, or the first of them and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _verb(count: int) -> dict[str, str]:
    return {"is": "is" if count == 1 else "are"}
