"""The cameras of a stage's photos, as tensors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ..model.scene import PosedImage


def camera_tensors(images: Sequence[PosedImage], device: torch.device) -> tuple[Tensor, Tensor]:
    """(V, 4, 4) world_to_camera and (V, 3, 3) intrinsics of the photos, float32 on the device."""
    poses = np.stack([image.world_to_camera for image in images])
    matrices = np.stack([image.camera.matrix() for image in images])
    return (
        torch.from_numpy(poses.astype(np.float32)).to(device),
        torch.from_numpy(matrices.astype(np.float32)).to(device),
    )
