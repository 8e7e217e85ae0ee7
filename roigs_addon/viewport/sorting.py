"""Sorts the Gaussians of several objects for drawing, the farthest first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
UInt32 = NDArray[np.uint32]

TURN = 2e-3
"""Rotation of a view in radians, in an object's frame, above which it is sorted again."""


@dataclass(frozen=True, eq=False)
class Segment:
    """Rows `start` to `stop` of a set, which are one object's: depth = means · axis + offset."""

    start: int
    stop: int
    axis: NDArray[np.float64]  # (3,)
    offset: float


@dataclass(frozen=True, eq=False)
class SortingView:
    """Everything that an order depends on, except the means.

    Attributes:
        segments: of the drawn objects.
        extent: typical distance of the objects' Gaussians from their origins.
    """

    segments: tuple[Segment, ...]
    extent: float

    def differs(self, other: SortingView) -> bool:
        """Whether `other` would give a visibly different order.

        Moving or scaling everything together changes no order. So only the axes' directions matter,
        and the objects' depths relative to one another.
        """
        if [(s.start, s.stop) for s in self.segments] != [
            (s.start, s.stop) for s in other.segments
        ]:
            return True
        return bool(np.abs(self._shape() - other._shape()).max(initial=0.0) > TURN)

    def _shape(self) -> NDArray[np.float64]:
        if not self.segments:
            return np.zeros(0)
        unit = max(float(np.linalg.norm(self.segments[0].axis)), 1e-30)
        axes = np.concatenate([s.axis for s in self.segments]) / unit
        offsets = np.array([s.offset - self.segments[0].offset for s in self.segments])
        return np.concatenate([axes, offsets / (unit * max(self.extent, 1e-30))])


def depths(means: Float32, segments: Sequence[Segment]) -> Float32:
    """Return the depths of the segments' rows, minus the first segment's offset.

    Seen from far away, this offset is so large that float32 could not resolve the rows' depths.
    """
    parts = [
        means[s.start : s.stop] @ s.axis.astype(np.float32)
        + np.float32(s.offset - segments[0].offset)
        for s in segments
    ]
    return np.concatenate(parts) if parts else np.zeros(0, np.float32)


def back_to_front(means: Float32, view: SortingView) -> UInt32:
    """Return the rows of `means` (N, 3) that belong to the segments, the farthest first."""
    order = ascending(depths(means, view.segments))[::-1]
    rows = [np.arange(s.start, s.stop, dtype=np.uint32) for s in view.segments]
    return np.concatenate(rows)[order] if rows else np.zeros(0, np.uint32)


def ascending(values: Float32) -> NDArray[np.intp]:
    """Stable argsort of float32.

    numpy sorts 16-bit integers stably in linear time (radix sort). Two such passes over the halves
    of an order-preserving 32-bit key are faster than its comparison sort of floats.
    """
    bits = values.view(np.uint32)
    # The bits of negative floats fall as the numbers grow; those of positive floats rise.
    keys = bits ^ np.where(bits >> 31, np.uint32(0xFFFFFFFF), np.uint32(0x80000000))
    order = np.argsort(keys.astype(np.uint16), kind="stable")
    high = (keys >> 16).astype(np.uint16)
    return order[np.argsort(high[order], kind="stable")]
