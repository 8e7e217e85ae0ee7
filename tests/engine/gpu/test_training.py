"""Whole trainings with compute shaders, on a processor that plays a GPU."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from roigs_engine.errors import KernelError
from roigs_engine.gpu.program import Commands, Program, close_gpu
from roigs_engine.model.gaussians import NAMES, Gaussians
from roigs_engine.model.scene import SfmScene
from roigs_engine.rasterize import rasterize
from roigs_engine.training.mechanisms.idle_pruning import IdlePruning
from roigs_engine.training.optimizer import VisibleAdam
from roigs_engine.training.trainer import Trainer
from tests.engine.cuda.short import CONFIG
from tests.engine.rasterize_cases import cameras, gaussians, relative_error
from tests.engine.synthetic_scene import make_scene, stage_data
from tests.engine.training.hidden import keeps_what_others_hide


def test_what_others_hide_keeps_values_and_moments(software: Program) -> None:
    keeps_what_others_hide("gpu")


@pytest.mark.parametrize("coefficients", [1, 16])
def test_a_step_is_that_of_the_cpu(software: Program, coefficients: int) -> None:
    """And a row whose gradient is not finite stays as it is."""
    scene = (*(camera[:1] for camera in cameras(40, 30)), 40, 30)
    models = []
    for backend in ("gpu", "cpu"):
        parameters = [p.clone() for p in gaussians(60, coefficients=coefficients, raw=True)]
        optimizer = VisibleAdam({n: (p, 1e-3) for n, p in zip(NAMES, parameters, strict=True)})
        optimizer.row_rates = 1.0 + (torch.arange(60) % 3)
        for step in range(3):
            taken = optimizer.backward_step
            output = rasterize(*parameters, *scene, raw=True, backend=backend, backward_step=taken)
            weights = torch.randn(output.image.shape, generator=torch.Generator().manual_seed(step))
            if step == 2:
                weights[0, :, 20:] = torch.nan
            (output.image * weights).sum().backward()
        models.append(optimizer)
    ours, truth = models
    assert int(ours.skipped_rows) == int(truth.skipped_rows) > 0
    for name in NAMES:
        for kind in ("exp_avg", "exp_avg_sq"):
            mine, theirs = getattr(ours, kind)[name], getattr(truth, kind)[name]
            assert relative_error(mine, theirs) < 1e-3, (kind, name)


def stepped(scene: SfmScene, looks: Container[int]) -> Trainer:
    """Six steps; after some of them, the opacities are changed."""
    start = Gaussians.from_points(scene.points[::6], scene.colors[::6])
    config = replace(CONFIG, steps=6, mechanisms=(IdlePruning(),))
    trainer = Trainer(start, stage_data(scene), config)
    for step in range(6):
        trainer.train_step()
        if step in looks:
            with torch.no_grad():
                trainer.gaussians.logit_opacities.mul_(0.98)
    return trainer


@pytest.mark.parametrize(("looks", "there"), [(range(6), 0), ((), 5), ((2,), 4)])
def test_training_on_a_gpu_is_training_on_the_cpu(
    software: Program,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    looks: Container[int],
    there: int,
) -> None:
    """Where the model is looked at, it stays in main memory for the next step."""
    scene = make_scene(tmp_path, views=4)
    launched = []
    launch = Commands.launch

    def watched(self: Commands, kernel: str, *given: Any, **more: Any) -> None:
        launched.append(kernel)
        launch(self, kernel, *given, **more)

    monkeypatch.setattr(Commands, "launch", watched)
    ours = stepped(scene, looks)
    assert {"gradient", "weigh", "project_backward"} < set(launched)
    assert launched.count("adam_sh") == there
    again = stepped(scene, looks)
    for name in NAMES:
        assert torch.equal(getattr(ours.gaussians, name), getattr(again.gaussians, name))
    close_gpu()
    plain = stepped(scene, looks)
    assert float(ours._metrics.loss) == pytest.approx(float(plain._metrics.loss), rel=1e-4)
    for name in NAMES:
        mine, theirs = getattr(ours.gaussians, name), getattr(plain.gaussians, name)
        # an alpha next to 1/255 is drawn or not by its last bit, and Adam steps by signs
        far = (mine - theirs).abs() > (1e-2 if name == "quats" else 1e-3)
        assert float(far.double().mean()) < 0.05, name


@pytest.mark.parametrize("lost_at", ["project", "blend", "gradient"])
@pytest.mark.parametrize("stays", [False, True])
def test_a_lost_gpu_is_one_line_and_no_half_step(
    software: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lost_at: str, stays: bool
) -> None:
    """The model in front of the step is still there, unless it is lost with the GPU."""
    scene = make_scene(tmp_path, views=4)
    start = Gaussians.from_points(scene.points[::6], scene.colors[::6])
    trainer = Trainer(start, stage_data(scene), replace(CONFIG, steps=6, mechanisms=()))
    trainer.train_step()
    trainer.train_step()
    before = None if stays else trainer.gaussians.sh.detach().clone()
    launch = Commands.launch

    def losing(self: Commands, kernel: str, *given: Any, **more: Any) -> None:
        if kernel == lost_at:
            software.device.destroy()
        launch(self, kernel, *given, **more)

    monkeypatch.setattr(Commands, "launch", losing)
    with pytest.raises(KernelError, match=r"failed while .*: .*[Dd]evice is lost") as caught:
        trainer.train_step()
    assert "\n" not in str(caught.value)
    assert trainer.step == 2
    if before is None:
        with pytest.raises(KernelError, match="failed while reading the model"):
            trainer.state_dict()
    else:
        assert trainer.is_between_steps
        assert torch.equal(trainer.state_dict()["parameters"]["sh"], before)
