"""Pictures of a model: one view, or every camera of a path file.

Camera path file (UTF-8 JSON, OpenCV axes, pixels and world units, docs/conventions.md):

    {"cameras": [{"name": "0001", "width": 960, "height": 540, "fx": 800.0, "fy": 800.0,
                  "cx": 480.0, "cy": 270.0, "world_to_camera": [[...4], [...4], [...4], [...4]]}]}

`world_to_camera` is a rotation and a translation; names are unique and become file names.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..cuda.memory import explain_out_of_memory, smaller_side
from ..model.gaussians import Gaussians
from ..model.scene import Camera, Float64
from . import RenderOutput, rasterize


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderedView:
    """One picture.

    Attributes:
        image: (H, W, 3) float32 sRGB values in [0, 1].
        depth: (H, W) expected depth along the camera's z axis, world units, 0 where nothing is;
            None unless asked for.
    """

    image: Tensor
    depth: Tensor | None


@torch.no_grad()
def render_view(
    gaussians: Gaussians,
    camera: Camera,
    world_to_camera: Float64,  # (4, 4)
    *,
    with_depth: bool = False,
    background: Tensor | None = None,  # (3,)
) -> RenderedView:
    """Render the model from one camera, on the model's device, without gradients."""
    size = camera.width, camera.height

    def doing() -> str:
        return f"drawing {len(gaussians):,} Gaussians at {size[0]}x{size[1]}"

    def advice() -> str:
        return f"Draw smaller pictures (--max-side {smaller_side(*size)}), or use --device cpu."

    with explain_out_of_memory(doing, advice):
        output = rasterize_view(
            gaussians, camera, world_to_camera, background=background, with_depth=with_depth
        )
    depth = output.depth[0] if with_depth and output.depth is not None else None
    return RenderedView(image=output.image[0].clamp(0, 1), depth=depth)


def rasterize_view(
    gaussians: Gaussians, camera: Camera, world_to_camera: Float64, **options: Any
) -> RenderOutput:
    """`rasterize` of a model from one camera, (4, 4) world_to_camera, on the model's device.

    Args: `options`: of `rasterize`.
    """
    device = gaussians.means.device
    viewmat = torch.as_tensor(np.asarray(world_to_camera), dtype=torch.float32, device=device)
    matrix = torch.as_tensor(camera.matrix(), dtype=torch.float32, device=device)
    return rasterize(
        gaussians.means,
        gaussians.quats,
        gaussians.log_scales,
        gaussians.logit_opacities,
        gaussians.sh,
        viewmat[None],
        matrix[None],
        camera.width,
        camera.height,
        raw=True,
        **options,
    )
