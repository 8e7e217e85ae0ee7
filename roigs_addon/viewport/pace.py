"""Resolution of a viewport while it changes, so that it stays fluent. No bpy.

Most of the time goes into blending, so a picture of half the width and height takes about a
quarter. It is much closer to the full picture than one with fewer Gaussians that takes the same
time (notebook/blender.md).
"""

from __future__ import annotations

from math import ceil, sqrt

QUICK = 0.1
"""Seconds: a picture that takes no longer is always drawn in full."""

COARSEST = 3
"""Pixels of the view across a pixel of the coarsest picture; beyond, blending is not what takes
the time."""


def pixel(seconds: float | None, held: int | None, rested: bool) -> int:
    """Width of a picture's pixel in pixels of the view; 1: drawn in full.

    Args:
        seconds: what a full picture takes; None: unknown.
        held: the width in the picture that is there; None: it shows something else.
        rested: whether the view has not changed for a while.
    """
    if seconds is None or seconds <= QUICK or (held is not None and rested):
        return 1
    return held or min(ceil(sqrt(seconds / QUICK)), COARSEST)


def full_seconds(taken: float, pixel: int, before: float | None) -> float | None:
    """The longest time for a full picture, estimated from one with pixels of that width.

    A first picture can be slow because programs are compiled for it; a coarse one shows that.

    Args:
        taken: seconds for the picture.
        pixel: the width in it.
        before: what was known.
    """
    if pixel == 1:
        return taken
    return before if before is None else min(before, taken * pixel**2)
