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

# Blender's stubs lack the constructors of these types and what these functions return.
TYPES: Any = gpu.types
STATE: Any = gpu.state


def texture(values: NDArray[np.float32], form: str) -> gpu.types.GPUTexture:
    """Float32 values (H, W) or (H, W, 4) as a texture of that format."""
    height, width = values.shape[:2]
    data = TYPES.Buffer("FLOAT", values.size, np.ascontiguousarray(values).reshape(-1))
    made: gpu.types.GPUTexture = TYPES.GPUTexture((width, height), format=form, data=data)
    return made


class SplatPicture:
    """The image for blending splats: premultiplied sRGB values or linear light, half floats.

    They need an image of their own: in the viewport's, they would all be blended in linear light,
    and with 8 bits.
    """

    def __init__(self, width: int, height: int) -> None:
        self.size = (width, height)
        self.texture = TYPES.GPUTexture(self.size, format="RGBA16F")
        self._framebuffer = TYPES.GPUFrameBuffer(color_slots=self.texture)

    def cleared(self) -> Any:
        """The framebuffer, transparent."""
        with self._framebuffer.bind():
            self._framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0))
        return self._framebuffer


@dataclass(frozen=True, eq=False)
class Depth:
    """Of what hides splats, 0 (near) to 1 per pixel; depths with the same mark are the same."""

    texture: gpu.types.GPUTexture
    mark: Hashable


def bound_depth(width: int, height: int) -> Depth:
    """A copy of the bound framebuffer's depth.

    Python cannot access the depth texture itself, so the copy goes through main memory.
    """
    bound = STATE.active_framebuffer_get()
    x, y = viewport_origin()
    data = bound.read_depth(x, y, width, height)
    data.dimensions = width * height
    made = TYPES.GPUTexture((width, height), format="R32F", data=data)
    return Depth(made, zlib.crc32(data))


def drawn() -> float:
    """Wait until the GPU has drawn everything, as reading a pixel does; the time then, seconds."""
    STATE.active_framebuffer_get().read_color(0, 0, 1, 1, 4, 0, "FLOAT")
    return time.perf_counter()


def viewport_origin() -> tuple[int, int]:
    """The lower left corner of the viewport in the bound framebuffer, pixels."""
    x, y = STATE.viewport_get()[:2]
    return x, y


def no_depth() -> Depth:
    """Stands for a depth of 1, the farthest, everywhere."""
    return Depth(texture(np.ones((1, 1), np.float32), "R32F"), None)
