"""Images on the GPU."""

from __future__ import annotations

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
    """What the splats are blended in: premultiplied sRGB values, half floats.

    They need an image of their own: in the viewport's, they would be blended in linear light and
    with 8 bits.
    """

    def __init__(self) -> None:
        self.texture: Any = None
        self._framebuffer: Any = None

    def cleared(self, width: int, height: int) -> Any:
        """The framebuffer in that size, transparent."""
        if self.texture is None or (self.texture.width, self.texture.height) != (width, height):
            self.texture = TYPES.GPUTexture((width, height), format="RGBA16F")
            self._framebuffer = TYPES.GPUFrameBuffer(color_slots=self.texture)
        with self._framebuffer.bind():
            self._framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0))
        return self._framebuffer


def bound_depth(width: int, height: int) -> gpu.types.GPUTexture:
    """A copy of the bound framebuffer's depth, 0 (near) to 1.

    Python cannot access the depth texture itself, so the copy goes through main memory.
    """
    bound = STATE.active_framebuffer_get()
    x, y = viewport_origin()
    data = bound.read_depth(x, y, width, height)
    data.dimensions = width * height
    made: gpu.types.GPUTexture = TYPES.GPUTexture((width, height), format="R32F", data=data)
    return made


def viewport_origin() -> tuple[int, int]:
    """The lower left corner of the viewport in the bound framebuffer, pixels."""
    x, y = STATE.viewport_get()[:2]
    return x, y


def no_depth() -> gpu.types.GPUTexture:
    """Stands for a depth of 1, the farthest, everywhere."""
    return texture(np.ones((1, 1), np.float32), "R32F")
