"""Describes in words where to take a photo."""

from __future__ import annotations

from dataclasses import dataclass

from ..formats.text import printable
from ..model.roi import OrientedBox
from ..model.scene import Float64
from .places import Offset
from .suggest import Suggestion

SAME = 0.05  # of the distance to the box; smaller offsets are not mentioned


@dataclass(frozen=True, kw_only=True)
class Units:
    """Formats lengths.

    Attributes:
        scale: metres per world unit; None: unknown.
    """

    scale: float | None

    def length(self, value: float) -> str:
        """A length in world units as text, without its sign."""
        if self.scale is None:
            return f"{abs(value):.2g} units"
        metres = abs(value) * self.scale
        if metres >= 1:
            return f"{metres:.1f} m"
        return f"{100 * metres:.0f} cm" if metres >= 0.03 else f"{1000 * metres:.0f} mm"


def in_words(shot: Suggestion, roi: OrientedBox, up: Float64, units: Units) -> str:
    """Describe a place to a person with a camera: distance, height, offset from a photo."""
    top = float((roi.corners() @ up).max() - roi.centre @ up)
    return printable(
        f"{units.length(shot.distance)} from the middle of '{roi.name}',"
        f" {_height(shot.height, top, shot.distance, units)};"
        f" {_beside(shot.near, shot.distance, units)}. Point the camera at '{roi.name}'."
    )


def _height(height: float, top: float, distance: float, units: Units) -> str:
    if abs(height) <= SAME * distance:
        return "at the height of its middle"
    if height > top:
        return f"{units.length(height - top)} above its top"
    if height < -top:
        return f"{units.length(-height - top)} below its bottom"
    return f"{units.length(height)} {'above' if height > 0 else 'below'} its middle"


def _beside(near: Offset, distance: float, units: Units) -> str:
    parts = [
        (near.right, "to the right", "to the left"),
        (near.up, "higher", "lower"),
        (near.forward, "forward", "back"),
    ]
    words = [
        f"{units.length(value)} {plus if value > 0 else minus}"
        for value, plus, minus in sorted(parts, key=lambda part: -abs(part[0]))
        if abs(value) > SAME * distance
    ]
    if not words:
        return f"where photo {near.photo} was taken"
    return f"from photo {near.photo}: {', '.join(words)}"
