"""The data that a stage trains on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from ..cuda.device import CPU
from ..cuda.photos import Photos
from ..model.roi import OrientedBox
from ..model.scene import Float64, PosedImage
from .budget import BoxBudget
from .config import TrainConfig
from .cutouts import Cutouts
from .densification import DensityInputs
from .masks import RoiMasks
from .photo_order import PhotoAt


@dataclass(frozen=True, kw_only=True, eq=False)
class SmallPhotos:
    """The photos of a stage at half their size; attributes as in `StageData`."""

    images: Sequence[PosedImage]
    photos: Photos
    masks: RoiMasks | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class StageData:
    """The data that a stage trains on.

    Attributes:
        images: posed photos.
        photos: their pixels, in the same order.
        photo_at: step -> position in `images` of the photo that the step uses.
        extent: the *scene's* extent, world units; scales position learning rates and pruning sizes.
        rois: boxes that limit densification, if the stage's config says so.
        budgets: Gaussian budget of each box; None: no limit.
        masks: masks for the steps that do not use whole photos (`config.full_every`).
        small: the photos at half their size, for the first steps (`config.is_small`).
        cutouts: the objects that some steps draw alone; None: there are none. The stage must not
            densify, and their rows are those of the `z_order` of its first model.
        points: (P, 3) of the scene, world units; used with `config.min_views`.
        backgrounds: (P, 3) colour behind all Gaussians, for each photo, on `device`; None: black.
        seed: for the positions of split Gaussians.
        device: where to train; devices differ only in rounding.
        card_photos: bytes of photos to keep on a GPU; None: a share of its free memory.
    """

    images: Sequence[PosedImage]
    photos: Photos
    photo_at: PhotoAt
    extent: float
    rois: Sequence[OrientedBox] = ()
    budgets: Sequence[BoxBudget] | None = None
    masks: RoiMasks | None = None
    small: SmallPhotos | None = None
    cutouts: Cutouts | None = None
    points: Float64 = field(default_factory=lambda: np.zeros((0, 3)))
    backgrounds: Tensor | None = None
    seed: int = 0
    device: torch.device = CPU
    card_photos: int | None = None

    def density_inputs(self, config: TrainConfig) -> DensityInputs:
        """What density control knows of the stage."""
        return DensityInputs(
            config=config,
            extent=self.extent,
            rois=self.rois,
            budgets=self.budgets,
            photos=len(self.images),
            seed=self.seed,
            device=self.device,
        )
