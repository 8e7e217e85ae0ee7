"""Anti-aliased Gaussians for viewers that draw without anti-aliasing.

Such a viewer draws a Gaussian below a pixel's size larger, and as opaque as it is stored. No stored
opacity is right from everywhere then. Here it becomes what it looks like in the photos, on average:
so the model is right from about where it was photographed, somewhat too thick from farther away and
too faint from nearer by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from ..model.gaussians import Gaussians
from ..model.rotations import rotation_matrices
from ..model.scene import PosedImage
from ..rasterize.inputs import NEAR, blur_of
from ..rasterize.reference import drawn_share, jacobian


@torch.no_grad()
def without_antialiasing(model: Gaussians, images: Sequence[PosedImage]) -> Gaussians:
    """An anti-aliased model as one that looks about the same without, from the photos.

    Args:
        model: on the CPU.
        images: the photos' cameras, in the model's frame. A Gaussian that none of them shows stays
            as it is.
    """
    axes = rotation_matrices(torch.nn.functional.normalize(model.quats, dim=1))
    axes = axes * model.log_scales.exp()[:, None, :]
    total, count = torch.zeros(len(model)), torch.zeros(len(model))
    for image in images:
        camera = image.camera
        pose = torch.as_tensor(image.world_to_camera, dtype=torch.float32)
        matrix = torch.as_tensor(camera.matrix(), dtype=torch.float32)
        centres = model.means @ pose[:3, :3].T + pose[:3, 3]
        place = centres[:, :2] / centres[:, 2:] * matrix.diagonal()[:2] + matrix[:2, 2]
        size = torch.tensor([camera.width, camera.height])
        rows = ((centres[:, 2] > NEAR) & (place > 0).all(1) & (place < size).all(1)).nonzero()[:, 0]
        projected = jacobian(centres[rows], matrix, camera.width, camera.height) @ pose[:3, :3]
        total[rows] += drawn_share(projected @ axes[rows], blur_of(1.0, antialiased=True))
        count[rows] += 1
    share = torch.where(count > 0, total / count.clamp(min=1), 1.0)
    opacity = model.logit_opacities.sigmoid() * share
    return replace(model, logit_opacities=torch.logit(opacity, eps=1e-6), antialiased=False)
