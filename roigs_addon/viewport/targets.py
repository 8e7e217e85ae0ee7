"""Images on the GPU."""

from __future__ import annotations

import gpu
import numpy as np
from numpy.typing import NDArray


def texture(values: NDArray[np.float32], form: str) -> gpu.types.GPUTexture:
    """Float32 values (H, W) or (H, W, 4) as a texture of that format."""
    height, width = values.shape[:2]
    data = gpu.types.Buffer("FLOAT", values.size, np.ascontiguousarray(values).reshape(-1))
    return gpu.types.GPUTexture((width, height), format=form, data=data)


class SplatPicture:
    """What the splats are blended in: premultiplied sRGB values, half floats.

    They need an image of their own: in the viewport's, they would be blended in linear light and
    with 8 bits.
    """

    def __init__(self) -> None:
        self.texture: gpu.types.GPUTexture | None = None
        self._framebuffer: gpu.types.GPUFrameBuffer | None = None

    def cleared(self, width: int, height: int) -> gpu.types.GPUFrameBuffer:
        """The framebuffer in that size, transparent."""
        if self.texture is None or (self.texture.width, self.texture.height) != (width, height):
            self.texture = gpu.types.GPUTexture((width, height), format="RGBA16F")
            self._framebuffer = gpu.types.GPUFrameBuffer(color_slots=self.texture)
        assert self._framebuffer is not None
        with self._framebuffer.bind():
            self._framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0))
        return self._framebuffer


def bound_depth(width: int, height: int) -> gpu.types.GPUTexture:
    """A copy of the bound framebuffer's depth, 0 (near) to 1.

    Python cannot access the depth texture itself, so the copy goes through main memory.
    """
    bound = gpu.state.active_framebuffer_get()
    x, y = gpu.state.viewport_get()[:2]
    data = bound.read_depth(x, y, width, height)
    data.dimensions = width * height
    return gpu.types.GPUTexture((width, height), format="R32F", data=data)


def no_depth() -> gpu.types.GPUTexture:
    """Stands for a depth of 1, the farthest, everywhere."""
    return texture(np.ones((1, 1), np.float32), "R32F")
