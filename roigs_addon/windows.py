"""Blender's windows: timers and redraws."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from . import blender

SHOWN = 2, 98
"""Percentiles between which points are framed."""
LEAST_RADIUS = 1e-6
VIEW_SENSOR, LONGER_SIDE = 36.0, 1.5
"""Half a 3D view's sensor in millimetres along its longer side, which is about so much longer."""


class Timer:
    """Calls a function on Blender's main thread, again and again, until it returns False.

    In background mode Blender calls no timers.
    """

    def __init__(self, work: Callable[[], bool], seconds: float, *, persistent: bool = False):
        """Prepare it.

        Args:
            work: what to call; False ends the timer.
            seconds: between two calls.
            persistent: whether the timer survives loading another file.
        """
        self._work, self._seconds, self._persistent = work, seconds, persistent
        # Blender knows a timer by its function, and a bound method is a new one at each access.
        self._function = self._call

    @property
    def running(self) -> bool:
        """Whether Blender is going to call it."""
        return bpy.app.timers.is_registered(self._function)

    def start(self) -> None:
        """Begin, unless it is running."""
        if not self.running:
            bpy.app.timers.register(
                self._function, first_interval=self._seconds, persistent=self._persistent
            )

    def stop(self) -> None:
        """End it."""
        if self.running:
            bpy.app.timers.unregister(self._function)

    def _call(self) -> float | None:
        return self._seconds if self._work() else None


def redraw(kind: str = "VIEW_3D") -> None:
    """Draw the areas of a kind again; by default the 3D views, with their sidebars."""
    for area in blender.areas(kind):
        area.tag_redraw()


def redraw_sidebars() -> None:
    """Draw the sidebars of the 3D views again, and nothing else."""
    for area in blender.areas("VIEW_3D"):
        for region in area.regions:
            if region.type == "UI":
                region.tag_redraw()


def move_views(scene: bpy.types.Scene, matrix: NDArray[np.float64]) -> None:
    """Have the 3D views of a scene show it as large as before, if a similarity (4, 4) moved it.

    Their directions stay, so that a floor that became level is seen as one.
    """
    factor, move = np.cbrt(np.linalg.det(matrix[:3, :3])), Matrix(matrix.tolist())
    for space, views in _views_of(scene):
        space.clip_start, space.clip_end = space.clip_start * factor, space.clip_end * factor
        for view in views:
            view.view_location = move @ view.view_location
            view.view_distance *= factor


def frame_views(scene: bpy.types.Scene, points: NDArray[Any]) -> None:
    """Have the 3D views of a scene show these points, (N, 3) in the world, but for outliers."""
    if not len(points):
        return
    low, high = np.percentile(points, SHOWN, axis=0)
    radius = max(float(np.linalg.norm(high - low)) / 2, LEAST_RADIUS)
    for space, views in _views_of(scene):
        distance = radius * space.lens / VIEW_SENSOR * LONGER_SIDE
        space.clip_start = min(space.clip_start, distance / 100)
        space.clip_end = max(space.clip_end, distance * 10)
        for view in views:
            view.view_location, view.view_distance = ((low + high) / 2).tolist(), distance


def _views_of(
    scene: bpy.types.Scene,
) -> Iterator[tuple[bpy.types.SpaceView3D, set[bpy.types.RegionView3D]]]:
    """The 3D views of a scene in all windows, which are then drawn again."""
    for window in blender.windows():
        for area in window.screen.areas if window.scene == scene else ():
            space = area.spaces.active
            if isinstance(space, bpy.types.SpaceView3D):
                yield space, {*space.region_quadviews, space.region_3d} - {None}
                area.tag_redraw()
