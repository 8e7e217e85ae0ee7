"""What the add-on does to Blender's windows: timers, and having things drawn again."""

from __future__ import annotations

from collections.abc import Callable

import bpy

from . import blender


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


def scale_views(scene: bpy.types.Scene, factor: float) -> None:
    """Have the 3D views of a scene show it as before, if all of it is that much larger now."""
    for window in blender.windows():
        if window.scene != scene:
            continue
        for area in window.screen.areas:
            space = area.spaces.active
            if not isinstance(space, bpy.types.SpaceView3D):
                continue
            space.clip_start, space.clip_end = space.clip_start * factor, space.clip_end * factor
            views = {*space.region_quadviews, space.region_3d} - {None}
            for view in views:
                view.view_location *= factor
                view.view_distance *= factor
            area.tag_redraw()
