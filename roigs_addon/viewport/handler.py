"""Draw handler that Blender calls for each 3D viewport, after the scene."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from typing import Any, Literal

import bpy


class ViewHandler:
    """Calls a function to draw in every 3D viewport.

    After an error, drawing stops: an error in a shader, for example, would repeat at every redraw.

    Attributes:
        failure: why drawing has stopped, in one line; empty if it has not.
    """

    def __init__(
        self,
        draw: Callable[[bpy.types.Context], None],
        failing: str,
        after: Literal["POST_VIEW", "POST_PIXEL"] = "POST_VIEW",
    ) -> None:
        """Prepare the handler.

        Args:
            draw: draws in the context's region.
            failing: beginning of the message about a failure.
            after: "POST_VIEW" draws with the view's matrices, "POST_PIXEL" in the region's pixels.
        """
        self._draw, self._failing, self._after = draw, failing, after
        self._handle: Any = None
        self.failure = ""

    def problem(self) -> str:
        """Return why drawing has stopped, in one line; empty if it has not."""
        return self.failure

    def start(self) -> None:
        """Start drawing; in background mode there is no viewport."""
        if self._handle is None and not bpy.app.background:
            self._handle = bpy.types.SpaceView3D.draw_handler_add(
                self._on_redraw, (), "WINDOW", self._after
            )

    def stop(self) -> None:
        """Stop drawing, and forget a failure."""
        if self._handle is not None:
            bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")
            self._handle = None
        self.failure = ""

    def _on_redraw(self) -> None:
        if self.failure:
            return
        try:
            self._draw(bpy.context)
        except Exception as error:
            self.failure = f"{self._failing} ({error})."
            traceback.print_exc()
