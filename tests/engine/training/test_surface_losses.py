"""Losses that make Gaussians a surface."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import SfmScene
from roigs_engine.rasterize.inputs import Surface
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms.masked_steps import MaskedSteps
from roigs_engine.training.mechanisms.surface_losses import SurfaceLosses
from roigs_engine.training.trainer import Trainer
from tests.engine.synthetic_scene import BOX, make_scene, stage_data, truth

SIDE, FOCAL = 24, 30.0
LENS = torch.tensor([[FOCAL, 0.0, SIDE / 2], [0.0, FOCAL, SIDE / 2], [0.0, 0.0, 1.0]])
NORMAL = torch.nn.functional.normalize(torch.tensor([0.3, -0.2, -1.0]), dim=0)
CONFIG = TrainConfig(steps=40, lr_means=1.6e-5, mechanisms=(MaskedSteps(whole_share=0.0),))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


def plane() -> Tensor:
    """(1, H, W) the depth of the plane through (0, 0, 2) across NORMAL."""
    y, x = torch.meshgrid(*(torch.arange(SIDE) + 0.5 - SIDE / 2,) * 2, indexing="ij")
    rays = torch.stack([x / FOCAL, y / FOCAL, torch.ones_like(x)], dim=-1)
    return (2 * NORMAL[2] / (rays @ NORMAL))[None]


def loss(depth: Tensor, mean: Tensor, normal: Tensor = NORMAL, **weights: Any) -> float:
    running = SurfaceLosses(**{"normals": 0.0, "thickness": 0.0, **weights}).begin(CONFIG, None)  # type: ignore[arg-type]
    normals = normal.expand(1, SIDE, SIDE, 3)
    surface = Surface(depth=mean, median=depth, normal=normals)
    return float(running.surface_loss(surface, torch.ones(1, SIDE, SIDE), LENS, None))


def test_a_plane_with_its_normal_costs_nothing() -> None:
    assert loss(plane(), plane(), normals=1.0, thickness=1.0) == pytest.approx(0.0, abs=1e-5)


def test_what_is_wrong_costs_its_weight() -> None:
    inner = (SIDE - 2) ** 2 / SIDE**2
    turned = -NORMAL
    assert loss(plane(), plane(), turned, normals=0.5) == pytest.approx(0.5 * 2 * inner, rel=1e-4)
    pixel = plane() / FOCAL
    assert loss(plane(), plane() + 3 * pixel, thickness=0.1) == pytest.approx(0.3, rel=1e-3)
    assert loss(plane(), plane() + 900 * pixel, thickness=0.1) == pytest.approx(2.0, rel=1e-3)


def test_where_no_surface_is_or_one_ends_normals_cost_nothing() -> None:
    assert loss(torch.zeros(1, SIDE, SIDE), plane(), -NORMAL, normals=1.0, thickness=1.0) == 0
    stairs = plane() + torch.arange(SIDE) // 2 % 2  # two pixels are never on one step
    assert loss(stairs, stairs, -NORMAL, normals=1.0) == 0


def trained(scene: SfmScene, *mechanisms: SurfaceLosses) -> tuple[Gaussians, float]:
    trainer = Trainer(truth(), stage_data(scene, rois=[BOX]), CONFIG.using(*mechanisms))
    assert trainer.run()
    with torch.no_grad():
        output = trainer.render(trainer.optimizer, (0, "whole"), None, with_surface=True)
    assert output.surface is not None
    surface = output.surface
    off = (surface.depth - surface.median).abs()[surface.median > 0]
    return trainer.gaussians, float(off.mean())


def test_a_stage_with_them_is_thinner(scene: SfmScene) -> None:
    (plain, before), (_, after) = trained(scene), trained(scene, SurfaceLosses(thickness=0.3))
    assert after < 0.95 * before
    without = trained(scene, SurfaceLosses(normals=0.0, thickness=0.0))[0]
    for one, other in zip(plain.tensors().values(), without.tensors().values(), strict=True):
        assert torch.allclose(one, other, atol=1e-5)
