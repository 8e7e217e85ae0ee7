"""Loss, Adam and whole trainings on the CUDA kernels, run by the shim."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import torch
from torch import Tensor

from roigs_engine.model.gaussians import NAMES
from roigs_engine.rasterize import rasterize
from roigs_engine.training import trainer
from roigs_engine.training.mechanisms.idle_pruning import IdlePruning
from roigs_engine.training.optimizer import VisibleAdam
from tests.engine.cuda.shim import ShimProgram
from tests.engine.cuda.short import CONFIG, trained
from tests.engine.rasterize_cases import cameras, gaussians, relative_error
from tests.engine.synthetic_scene import make_scene
from tests.engine.training.hidden import keeps_what_others_hide
from tests.engine.training.reference_loss import photo_loss


def picture(height: int, width: int) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(height, width, 3, generator=generator)
    photo = torch.randint(0, 256, (height, width, 3), dtype=torch.uint8, generator=generator)
    return image, photo, torch.rand(height, width, generator=generator)


@pytest.mark.parametrize("size", [(1, 1), (5, 40), (33, 20)])
@pytest.mark.parametrize("weighted", ["no", "yes", "zero"])
def test_the_loss_is_the_reference(shim: ShimProgram, size: tuple[int, int], weighted: str) -> None:
    image, photo, weights = picture(*size)
    given = None if weighted == "no" else weights * (weighted == "yes")
    results = []
    for backend, dtype in (("cuda", torch.float32), ("reference", torch.float64)):
        leaf = image.to(dtype).requires_grad_()
        loss = photo_loss(leaf, photo, weights=given, backend=backend)
        (gradient,) = torch.autograd.grad(3 * loss.loss, leaf)
        results.append((*loss, gradient))
    for ours, truth in zip(results[0][:3], results[1][:3], strict=True):
        assert ours.item() == pytest.approx(truth.item(), abs=1e-5)
    assert relative_error(results[0][3], results[1][3]) < 1e-4


def test_ignored_pixels_have_no_gradient(shim: ShimProgram) -> None:
    image, photo, weights = picture(30, 25)
    image[3, 4] = torch.nan
    counted = weights > 0.3
    counted[3, 4] = False
    leaf = image.requires_grad_()
    loss = photo_loss(leaf, photo, counted=counted, backend="cuda")
    truth = photo_loss(image.detach(), photo, counted=counted, backend="cpu")
    assert loss.loss.item() == pytest.approx(float(truth.loss), abs=1e-5)
    loss.loss.backward()
    assert leaf.grad is not None and not leaf.grad[~counted].any()


def test_what_others_hide_keeps_values_and_moments(shim: ShimProgram) -> None:
    keeps_what_others_hide("cuda")


@pytest.mark.parametrize("coefficients", [1, 16])
def test_the_fused_step_is_adam_with_the_gradients(shim: ShimProgram, coefficients: int) -> None:
    """And a row whose gradient is not finite stays as it is."""
    scene = (*(camera[:1] for camera in cameras(40, 30)), 40, 30)
    models = []
    for backend in ("cuda", "cpu"):
        parameters = [p.clone() for p in gaussians(60, coefficients=coefficients, raw=True)]
        parameters[3][7] = 90.0  # opaque: exp(-90) makes no gradient
        pairs = zip(NAMES, parameters, strict=True)
        optimizer = VisibleAdam({name: (p, 1e-3) for name, p in pairs})
        optimizer.row_rates = 1.0 + (torch.arange(60) % 3)
        for step in range(3):
            output = rasterize(
                *parameters,
                *scene,
                raw=True,
                backend=backend,
                backward_step=optimizer.backward_step,
            )
            weights = torch.randn(output.image.shape, generator=torch.Generator().manual_seed(step))
            if step == 2:
                weights[0, :, 20:] = torch.nan
            (output.image * weights).sum().backward()
        models.append(optimizer)
    ours, truth = models
    assert int(ours.skipped_rows) == int(truth.skipped_rows) > 0
    assert isinstance(ours.skipped_rows, Tensor)
    for name in NAMES:
        for kind in ("exp_avg", "exp_avg_sq"):
            mine, theirs = getattr(ours, kind)[name], getattr(truth, kind)[name]
            assert relative_error(mine, theirs) < 1e-3, (kind, name)


def test_training_on_the_kernels_is_training_on_the_cpu(
    shim: ShimProgram, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = make_scene(tmp_path, views=4)
    config = replace(CONFIG, steps=6, mechanisms=(IdlePruning(every=1),))
    plain = trained(scene, config)
    for name, function in (("rasterize", rasterize), ("photo_loss", photo_loss)):
        monkeypatch.setattr(trainer, name, partial(function, backend="cuda"))
    ours = trained(scene, config)
    assert {"project_backward_adam", "loss_gradient", "weigh"} < set(shim.launched)
    assert "project_backward" not in shim.launched
    assert float(ours._metrics.loss) == pytest.approx(float(plain._metrics.loss), rel=1e-4)
    for name in NAMES:
        mine, theirs = getattr(ours.gaussians, name), getattr(plain.gaussians, name)
        # an alpha next to 1/255 is drawn or not by its last bit, and Adam steps by signs
        far = (mine - theirs).abs() > (1e-2 if name == "quats" else 1e-3)
        assert float(far.double().mean()) < 0.05, name
