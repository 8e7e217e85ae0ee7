"""Images on the GPU."""

from __future__ import annotations

import time
import zlib
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

import gpu
import numpy as np
from numpy.typing import NDArray

# Blender's stubs lack the constructors of these types and the return types of these functions.
TYPES: Any = gpu.types
STATE: Any = gpu.state


def texture(values: NDArray[np.float32], form: str) -> gpu.types.GPUTexture:
    """Create a texture of a format from float32 values (H, W) or (H, W, 4)."""
    height, width = values.shape[:2]
    data = TYPES.Buffer("FLOAT", values.size, np.ascontiguousarray(values).reshape(-1))
    made: gpu.types.GPUTexture = TYPES.GPUTexture((width, height), format=form, data=data)
    return made


class SplatPicture:
    """The image for blending splats: premultiplied sRGB values or linear light, half floats.

    Splats need a separate image: in the viewport's, they would all be blended in linear light, and
    with 8 bits.
    """

    def __init__(self, width: int, height: int) -> None:
        self.size = (width, height)
        self.texture = TYPES.GPUTexture(self.size, format="RGBA16F")
        self._framebuffer = TYPES.GPUFrameBuffer(color_slots=self.texture)

    def cleared(self) -> Any:
        """Clear the framebuffer to transparent, and return it."""
        with self._framebuffer.bind():
            self._framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0))
        return self._framebuffer


@dataclass(frozen=True, eq=False)
class Depth:
    """Depth of surfaces that hide splats, 0 (near) to 1 per pixel; equal marks: equal depths."""

    texture: gpu.types.GPUTexture
    mark: Hashable


def bound_depth(width: int, height: int) -> Depth:
    """Copy the bound framebuffer's depth.

    Python cannot access the depth texture itself, so the copy goes through main memory.
    """
    bound = STATE.active_framebuffer_get()
    x, y = viewport_origin()
    data = bound.read_depth(x, y, width, height)
    data.dimensions = width * height
    made = TYPES.GPUTexture((width, height), format="R32F", data=data)
    return Depth(made, zlib.crc32(data))


def drawn() -> float:
    """Wait until the GPU has finished, by reading a pixel; return the time in seconds."""
    STATE.active_framebuffer_get().read_color(0, 0, 1, 1, 4, 0, "FLOAT")
    return time.perf_counter()


def viewport_origin() -> tuple[int, int]:
    """Return the lower left corner of the viewport in the bound framebuffer, in pixels."""
    x, y = STATE.viewport_get()[:2]
    return x, y


def no_depth() -> Depth:
    """Return a depth of 1, the farthest, for all pixels."""
    return Depth(texture(np.ones((1, 1), np.float32), "R32F"), None)
