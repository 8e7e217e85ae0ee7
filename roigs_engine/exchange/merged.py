"""Makes one model of models that were moved, turned, scaled or sheared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from ..model.gaussians import Gaussians
from ..model.local_frame import LocalFrame
from ..model.operations import faded, recoloured
from ..model.scene import Float64
from ..rasterize.instances import Instance, transformed
from .turned_sh import turned_sh


def merged(models: Sequence[Instance]) -> tuple[Gaussians, LocalFrame]:
    """One model of all, in the world, and the frame that it is in.

    Args:
        models: at least one Gaussian in all.
    """
    bands = max(model.gaussians.sh.shape[1] for model in models)
    parts = [_in_world(model, bands) for model in models]
    centres = np.concatenate([centres for centres, _ in parts])
    frame = LocalFrame.of_centres(centres)
    model = Gaussians.concatenate([part for _, part in parts])
    means = torch.from_numpy(frame.points(centres).astype(np.float32))
    log_scales = model.log_scales + float(np.log(frame.scale))
    return replace(model, means=means, log_scales=log_scales), frame


def _in_world(model: Instance, bands: int) -> tuple[Float64, Gaussians]:
    """(N, 3) centres in the world, and the model there as it looks, with so many SH bands."""
    gaussians, to_world = model.gaussians, model.from_frame
    linear = to_world[:3, :3]
    quats, log_scales = transformed(gaussians, linear)
    centres = gaussians.means.numpy().astype(np.float64) @ linear.T + to_world[:3, 3]
    return centres, replace(
        gaussians,  # the centres are replaced when the frame of all is known
        quats=quats,
        log_scales=log_scales,
        logit_opacities=faded(gaussians.logit_opacities, model.density),
        sh=_padded(recoloured(turned_sh(gaussians.sh, linear), model.gains), bands),
    )


def _padded(sh: Tensor, bands: int) -> Tensor:
    """(N, bands, 3) with zeros for what is missing."""
    return torch.nn.functional.pad(sh, (0, 0, 0, bands - sh.shape[1]))
