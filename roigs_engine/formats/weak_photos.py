"""Which photos of a COLMAP model observe so few points that their cameras may be wrong."""

from __future__ import annotations

from collections.abc import Mapping

FEWEST = 30
"""COLMAP itself registers a photo only by so many points. It has fewer if they proved wrong later,
or if lower limits were used to place it at all."""


def weak_photos(points: Mapping[str, int]) -> list[str]:
    """The photos with fewer points, the fewest first.

    Args:
        points: photo -> how many it observes.
    """
    found = [name for name, count in points.items() if count < FEWEST]
    return sorted(found, key=lambda name: (points[name], name))
