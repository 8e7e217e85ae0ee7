"""One level: the Gaussians that contribute most, trained to look like the whole part from afar."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..context import QUIET, Context
from ..cuda.device import CPU
from ..model.gaussians import Gaussians
from ..model.scene import PosedImage
from ..rasterize.limits import PICTURE_LIMITS
from ..rasterize.view import View, blending_weights
from ..training.config import TrainConfig
from ..training.photo_order import shuffled
from ..training.stage_data import StageData
from ..training.trainer import Trainer
from .parts import Part
from .teacher import BLACK, WHITE, TeacherPictures, views_at

STEPS = 500
SHARE = 0.5
"""A part is trained for longer if less than this share of the views shows a Gaussian, mean."""
LONGEST = 4.0  # times as long
FAINTEST = 1 / 255  # blending weight with which a view shows a Gaussian
LEAST = 64  # Gaussians of a level


def coarseness(level: int) -> float:
    """How many times coarser than its photos a view shows a part when level `level` is made for it.

    Half the Gaussians serve 4^(1/3) times the distance: an eighth of them 4 times.
    """
    return float(4 ** (level / 3))


def count_at(level: int, whole: int) -> int:
    """Number of Gaussians of a level."""
    return max(LEAST, whole >> level)


def make_level(
    part: Part,
    start: Gaussians,
    views: list[View],
    level: int,
    *,
    steps: int = STEPS,
    context: Context = QUIET,
) -> Gaussians | None:
    """A level of a part; None if it is stopped, or no view shows the part so coarsely.

    Args:
        part: the whole of it.
        start: the level before, or the whole.
        views: that show the part.
        level: from 1.
        steps: to train for, if `SHARE` of the views show each Gaussian; more if fewer do.
        context: gives the device; receives progress.

    Raises:
        Stopped: on request.
    """
    coarser = coarseness(level)
    small = views_at(part, views, coarser)
    if not small:
        return None
    weights, share = contributions(start, small, context)
    steps = round(steps * min(max(SHARE / max(share, 1e-6), 1.0), LONGEST))
    kept = weights.topk(min(count_at(level, len(part.gaussians)), len(start))).indices.sort().values
    device = torch.device(context.device)
    backgrounds = [(BLACK, WHITE)[k % 2] for k in range(len(small))]
    config = TrainConfig(
        steps=steps,
        sh_degree=int(np.sqrt(start.sh.shape[1])) - 1,
        sh_start=3,
        lr_shN=1.25e-3,
        lr_scales=0.01,
        densify_until=0,
        densify_from=0,
        reset_every=0,
        prune_opacity=0.0,
        average_steps=steps // 5,
        antialiased=start.antialiased,
    )
    data = StageData(
        images=[_image(view, k) for k, view in enumerate(small)],
        photos=TeacherPictures(part, small, backgrounds, coarser, context),
        photo_at=shuffled(range(len(small)), 0),
        extent=_extent(part),
        backgrounds=torch.tensor(backgrounds, device=device)[:, None].expand(-1, 3),
        device=device,
    )
    trainer = Trainer(start.rows(kept), data, config)
    name = f"level {level} of {part.box or 'surroundings'}"
    if not trainer.run(context, stage=name):
        context.check_cancelled()
        return None
    return trainer.gaussians.detached().to(CPU)


@torch.no_grad()
def contributions(
    gaussians: Gaussians, views: list[View], context: Context = QUIET
) -> tuple[Tensor, float]:
    """(N,) how much each Gaussian contributes to the views, on the CPU; in which share of them.

    The product of its largest blending weight and the root of their sum: what is bright in one view
    counts, and what fills many. The share is the mean over the Gaussians.
    """
    model = gaussians.to(torch.device(context.device))
    most, total, shown = (model.means.new_zeros(len(model)) for _ in range(3))
    for weights in blending_weights(model, views, context, limits=PICTURE_LIMITS):
        most, total = torch.maximum(most, weights.largest), total + weights.total
        shown += weights.largest > FAINTEST
    return (most * total.sqrt()).cpu(), float(shown.mean()) / max(len(views), 1)


def _extent(part: Part) -> float:
    """Radius of the part, for the learning rate of positions."""
    return float(np.linalg.norm(part.probes - part.probes.mean(axis=0), axis=1).max())


def _image(view: View, number: int) -> PosedImage:
    camera, pose = view
    nowhere = np.zeros(0, dtype=np.int64)
    return PosedImage(
        name=f"view {number}",
        path=Path(),  # its pixels are drawn
        camera=camera,
        world_to_camera=pose,
        point_indices=nowhere,
    )
