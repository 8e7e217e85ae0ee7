"""On an NVIDIA GPU: the compiled backend against the float64 reference, and whole trainings.

Without a card, every test is skipped, with the reason.
"""

from __future__ import annotations

from typing import Any

import pytest
import torch

from roigs_engine.cuda import pair_buffers
from roigs_engine.cuda.device import CPU, check_cuda
from roigs_engine.errors import KernelError
from roigs_engine.evaluation.metrics import mean_in, psnr_from_mse, squared_error
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import SfmScene
from roigs_engine.rasterize import rasterize
from roigs_engine.rasterize.view import render_view
from roigs_engine.training import loop
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.floaters import consistent_across_views
from roigs_engine.training.losses import photo_loss
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.trainer import Trainer
from tests.engine.rasterize_cases import (
    CASES,
    SIZE,
    cameras,
    differentiate,
    gaussians,
    gradient_errors,
    relative_error,
    ring,
)
from tests.engine.synthetic_scene import BOX, make_scene, stage_data

pytestmark = pytest.mark.cuda
CARD = torch.device("cuda")


@pytest.fixture(autouse=True)
def _card() -> None:
    try:
        check_cuda()
    except KernelError as error:
        pytest.skip(str(error))


def on_card(values: Any) -> Any:
    if isinstance(values, torch.Tensor):
        return values.to(CARD)
    return [on_card(v) for v in values]


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("raw", [False, True])
def test_images_and_gradients_are_those_of_the_reference(name: str, raw: bool) -> None:
    parameters, views = gaussians(300, raw=raw), cameras(*SIZE)
    options = {"raw": raw, **CASES[name]}
    truth, true_gradients = differentiate(
        "reference", torch.float64, parameters, *views, *SIZE, **options
    )
    leaves = [p.to(CARD).requires_grad_() for p in parameters]
    moved = {k: on_card(v) if isinstance(v, torch.Tensor) else v for k, v in options.items()}
    ours = rasterize(*leaves, *on_card(views), *SIZE, **moved)
    weights = torch.randn(ours.image.shape, generator=torch.Generator().manual_seed(1))
    (ours.image * weights.to(CARD)).sum().backward()
    # the card's exponential is a fast one
    assert (ours.image.cpu() - truth.image).abs().max() < 1e-3
    gradients = [p.grad.cpu() for p in leaves if p.grad is not None]
    assert max(gradient_errors(gradients, true_gradients).values()) < 5e-3
    assert relative_error(ours.grad2d.cpu(), truth.grad2d) < 5e-3


@pytest.mark.parametrize("masked", [False, True])
def test_weights_and_depth_are_those_of_the_reference(masked: bool) -> None:
    parameters, views = gaussians(300), cameras(*SIZE)
    options = {"with_max_weight": True, "with_weight_sum": True, "with_depth": True}
    region = ring() if masked else None
    truth = rasterize(*parameters, *views, *SIZE, mask=region, backend="reference", **options)
    region = None if region is None else region.to(CARD)
    ours = rasterize(*on_card(parameters), *on_card(views), *SIZE, mask=region, **options)
    assert (ours.max_weight.cpu() - truth.max_weight).abs().max() < 1e-3
    assert relative_error(ours.weight_sum.cpu(), truth.weight_sum) < 1e-3
    assert relative_error(ours.depth.cpu(), truth.depth) < 1e-3


def test_the_loss_is_that_of_the_cpu() -> None:
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(70, 90, 3, generator=generator)
    photo = torch.randint(0, 256, (70, 90, 3), dtype=torch.uint8, generator=generator)
    ours, truth = photo_loss(image.to(CARD), photo.to(CARD)), photo_loss(image, photo)
    assert float(ours.loss) == pytest.approx(float(truth.loss), abs=1e-5)


def test_floaters_are_those_of_the_cpu(tmp_path_factory: pytest.TempPathFactory) -> None:
    scene = make_scene(tmp_path_factory.mktemp("photos"), views=6)
    model = Gaussians.from_points(scene.points[::3], scene.colors[::3])
    truth = consistent_across_views(model, scene.images, [BOX], scene.points, 3)
    found = consistent_across_views(model.to(CARD), scene.images, [BOX], scene.points, 3)
    assert found.device.type == "cuda" and torch.equal(found.cpu(), truth)


def test_trainings_end_alike(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Within 0.2 dB; the demo scene's long training is measured by benchmarks/README.md."""
    scene = make_scene(tmp_path_factory.mktemp("photos"))
    density = DensityControl(start=50, until=200)
    config = TrainConfig(steps=400, sh_every=100, mechanisms=(density,))
    found = []
    for device in (CPU, CARD):
        data = stage_data(scene, seed=0, device=device)
        start = Gaussians.from_points(scene.points[::3], scene.colors[::3])
        trainer = Trainer(start, data, config)
        assert trainer.run()
        model, scores = trainer.gaussians, []
        for index, image in enumerate(scene.images):
            view = render_view(model, image.camera, image.world_to_camera).image.cpu()
            photo = torch.from_numpy(data.photos[index]) / 255
            scores.append(psnr_from_mse(mean_in(squared_error(view, photo))))
        found.append(sum(scores) / len(scores))
    assert found[0] == pytest.approx(found[1], abs=0.2)


def test_a_step_does_not_wait_for_the_card(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Once every view was drawn: its first drawing waits for the number of its pairs."""
    scene = make_scene(tmp_path_factory.mktemp("photos"), views=4)
    trainer = trainer_on_card(scene, TrainConfig(steps=100))
    for _ in range(10):
        trainer.train_step()
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        for _ in range(8):
            trainer.train_step()
    finally:
        torch.cuda.set_sync_debug_mode("default")


def test_views_with_small_buffers_are_drawn_again(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A training that must do steps again ends with the bits of one that waits."""
    scene = make_scene(tmp_path_factory.mktemp("photos"), views=4)
    monkeypatch.setattr(pair_buffers, "MARGIN", 1.0)
    monkeypatch.setattr(pair_buffers, "LEAST_MARGIN", 0)
    models = []
    for made in (pair_buffers.pair_buffers_on, lambda device: None):
        monkeypatch.setattr(loop, "pair_buffers_on", made)
        config = TrainConfig(steps=200, mechanisms=(DensityControl(start=50, until=150),))
        trainer = trainer_on_card(scene, config)
        assert trainer.run()
        models.append(trainer.gaussians.tensors())
    for name, tensor in models[0].items():
        assert torch.equal(tensor, models[1][name]), name


def trainer_on_card(scene: SfmScene, config: TrainConfig) -> Trainer:
    data = stage_data(scene, seed=0, device=CARD)
    return Trainer(Gaussians.from_points(scene.points, scene.colors), data, config)
