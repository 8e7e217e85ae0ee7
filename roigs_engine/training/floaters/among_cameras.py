"""Prunes what hangs in the air among the cameras, where no photo looks (ours).

With few photos, a Gaussian can hang near a camera and outside its frame, as a faint blot in photos
from far away. A view that looks that way from there shows nothing else. Views put between the
photos (`between_views.py`) miss it unless one looks just that way, so here is a rule without views.

Nothing real hangs there: it would be nearer to a camera than half the distance to the scene's
points. And a camera that turned to it would see it large, but no photo within four times that
distance does: it fills less than 1 / 4^2 as much of any photo.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from ...model.gaussians import Gaussians
from ...model.scene import Float64, PosedImage
from .view_shares import LEAST, MORE, in_the_air

NEARER = 2.0  # times nearer to a camera than to the scene


def hangs_among_cameras(
    gaussians: Gaussians, images: Sequence[PosedImage], points: Float64, shown: Tensor
) -> Tensor:
    """(N,) bool: which Gaussians hang in the air among the cameras, where no photo looks.

    Args:
        gaussians: the model, N rows.
        images: the training photos; their pixels are not used.
        points: (P, 3) of the scene, world units; without any, nothing hangs.
        shown: (N,) the largest share of a photo that each fills (`view_shares.py`).
    """
    device = gaussians.means.device
    if len(points) == 0:
        return torch.zeros(len(gaussians), dtype=torch.bool, device=device)
    means = gaussians.means.detach().cpu().numpy().astype(np.float64)
    distance, nearest = cKDTree([image.centre for image in images]).query(means)
    # the area of a Gaussian that is seen from its broad side is 2 pi s1 s2
    scales = gaussians.log_scales.detach().exp().sort(dim=1).values.cpu().numpy().astype(np.float64)
    opacity = gaussians.logit_opacities.detach().sigmoid().cpu().numpy().astype(np.float64)
    zoom = np.array([_zoom(image) for image in images])[nearest]
    area = 2 * np.pi * scales[:, 1] * scales[:, 2] * zoom
    with np.errstate(divide="ignore"):  # a Gaussian at a camera's very place
        filled = opacity * np.minimum(area / distance**2, 1.0)
    seen = shown.cpu().numpy()
    unseen = (seen < LEAST) & (filled > LEAST) & (filled > MORE * seen)
    return torch.from_numpy(unseen).to(device) & in_the_air(gaussians, images, points, NEARER)


def _zoom(image: PosedImage) -> float:
    """The share of the photo that a unit area fills at unit distance."""
    camera = image.camera
    return camera.fx * camera.fy / (camera.width * camera.height)
