"""What is wrong with photos before anything is matched, in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..formats.text import counted
from .database import FEWEST_INLIERS, PANORAMIC, STILL, Pair
from .look import Found, Photo

GROUP = 3  # photos: fewer that match nothing else are single photos
# Of the pairs. Real scenes with walls and tables have up to 54 % that a plane explains too.
ONE_PLACE, BEHIND = 0.9, 0.5
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
        *unread_in_words(found.unread),
        *(
            f"{counted(len(names), 'photo')} {text.format(**_verb(len(names)))}: {named(names)}."
            for names, text in checks
            if names
        ),
    ]


def unread_in_words(unread: Mapping[str, int]) -> list[str]:
    """The sentence about photos whose format is not read, if there are any; see `Found`."""
    kinds = [f"{number} {kind}" for kind, number in sorted(unread.items())]
    total = sum(unread.values())
    were = "file was" if total == 1 else "files were"
    what = "it" if total == 1 else "them"
    return [f"{', '.join(kinds)} {were} not read: export {what} as JPEG."] if kinds else []


def warnings_of_matches(
    names: Sequence[str], matched: Mapping[Pair, int], kinds: Mapping[int, int]
) -> list[str]:
    """What the matches tell before photos are placed: one sentence each, usually none.

    Args:
        names: of the photos.
        matched: `database.matched_pairs`.
        kinds: `database.pair_kinds`.
    """
    found = []
    groups = [group for group in connected(names, matched) if len(group) >= GROUP]
    if len(groups) > 1:
        parts = "; ".join(f"{counted(len(group), 'photo')}: {named(group, 2)}" for group in groups)
        found.append(f"The photos show {len(groups)} places that nothing connects ({parts}).")
    total = sum(kinds.values())
    if total and sum(kinds.get(kind, 0) for kind in PANORAMIC) > ONE_PLACE * total:
        found.append(
            "Most photos were taken from one place, where depth cannot be seen."
            " Move the camera sideways between photos."
        )
    if total and sum(kinds.get(kind, 0) for kind in STILL) > BEHIND * total:
        found.append(
            "In most photos, the background stands still, as with a turntable."
            " Give masks that hide it (Masks, --masks), or move the camera instead."
        )
    return found


def connected(names: Sequence[str], matched: Mapping[Pair, int]) -> list[list[str]]:
    """The photos in groups that verified pairs connect, the largest first."""
    leader = {name: name for name in names}

    def leading(name: str) -> str:
        while leader[name] != name:
            leader[name] = name = leader[leader[name]]
        return name

    for (one, other), matches in matched.items():
        if matches >= FEWEST_INLIERS and one in leader and other in leader:
            leader[leading(one)] = leading(other)
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(leading(name), []).append(name)
    return sorted(groups.values(), key=len, reverse=True)


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
