"""Chooses the resolution of a viewport while it changes, so that it stays responsive. No bpy.

Most of the time goes into blending, so a picture of half the width and height takes about a
quarter. It is much closer to the full picture than one with fewer Gaussians that takes the same
time (notebook/blender.md).
"""

from __future__ import annotations

from math import ceil, sqrt

QUICK = 0.1
"""Seconds for a picture up to which it is always drawn in full."""

COARSEST = 3
"""Width of a pixel of the coarsest picture, in pixels of the view; beyond, blending does not take
most of the time."""


def pixel(seconds: float | None, held: int | None, rested: bool) -> int:
    """Return the width of a picture's pixel in pixels of the view; 1 draws it in full.

    Args:
        seconds: time for a full picture; None if unknown.
        held: this width in the existing picture; None if that shows another view.
        rested: whether the view has not changed for a while.
    """
    if seconds is None or seconds <= QUICK or (held is not None and rested):
        return 1
    return held or min(ceil(sqrt(seconds / QUICK)), COARSEST)


def full_seconds(taken: float, pixel: int, before: float | None) -> float | None:
    """Estimate the longest time for a full picture from a picture with pixels of this width.

    A first picture can be slow because programs are compiled for it. A coarse one corrects this.

    Args:
        taken: seconds for the picture.
        pixel: width of its pixels.
        before: the earlier estimate; None without one.
    """
    if pixel == 1:
        return taken
    return before if before is None else min(before, taken * pixel**2)
