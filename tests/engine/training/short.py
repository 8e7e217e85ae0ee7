"""A training of a second."""

from __future__ import annotations

import torch

from roigs_engine.model.gaussians import NAMES, Gaussians
from roigs_engine.model.scene import SfmScene
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.mechanisms.idle_pruning import IdlePruning

DENSITY = DensityControl(start=10, until=50, every=10, grad_threshold=1e-5, reset_every=30)
PLAIN = TrainConfig(steps=60, sh_every=20)
SHORT = PLAIN.using(DENSITY, IdlePruning(every=20))


def first_model(scene: SfmScene) -> Gaussians:
    return Gaussians.from_points(scene.points[::3], scene.colors[::3])


def same_bits(a: Gaussians, b: Gaussians) -> bool:
    return all(
        torch.equal(*(getattr(model, n).detach().view(torch.int32) for model in (a, b)))
        for n in NAMES
    )
