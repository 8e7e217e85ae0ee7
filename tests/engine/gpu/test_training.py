"""Whole trainings with compute shaders, on a processor that plays a GPU."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from roigs_engine.errors import KernelError
from roigs_engine.gpu.program import Commands, Program, close_gpu
from roigs_engine.model.gaussians import NAMES
from roigs_engine.rasterize import rasterize
from roigs_engine.training.mechanisms.idle_pruning import IdlePruning
from roigs_engine.training.optimizer import VisibleAdam
from roigs_engine.training.trainer import Trainer
from tests.engine.cuda.short import CONFIG, trained
from tests.engine.rasterize_cases import cameras, gaussians, relative_error
from tests.engine.synthetic_scene import make_scene
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


def test_training_on_a_gpu_is_training_on_the_cpu(
    software: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = make_scene(tmp_path, views=4)
    config = replace(CONFIG, steps=6, mechanisms=(IdlePruning(every=1),))
    launched = set()
    launch = Commands.launch

    def watched(self: Commands, kernel: str, *given: object, **more: object) -> None:
        launched.add(kernel)
        launch(self, kernel, *given, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(Commands, "launch", watched)
    ours = trained(scene, config)
    assert {"gradient", "weigh", "project_backward"} < launched
    again = trained(scene, config)
    for name in NAMES:
        assert torch.equal(getattr(ours.gaussians, name), getattr(again.gaussians, name))
    close_gpu()
    plain = trained(scene, config)
    assert float(ours._metrics.loss) == pytest.approx(float(plain._metrics.loss), rel=1e-4)
    for name in NAMES:
        mine, theirs = getattr(ours.gaussians, name), getattr(plain.gaussians, name)
        # an alpha next to 1/255 is drawn or not by its last bit, and Adam steps by signs
        far = (mine - theirs).abs() > (1e-2 if name == "quats" else 1e-3)
        assert float(far.double().mean()) < 0.05, name


@pytest.mark.parametrize("lost_at", ["project", "blend", "gradient"])
def test_a_lost_gpu_leaves_the_step_before(
    software: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lost_at: str
) -> None:
    """Wherever it is lost, a checkpoint can be written: the error is one line."""
    scene = make_scene(tmp_path, views=4)
    trainers: list[Trainer] = []
    launch, left = Commands.launch, [3]

    def losing(self: Commands, kernel: str, *given: object, **more: object) -> None:
        left[0] -= kernel == lost_at
        if left[0] < 0:
            raise software.library.GPUError("Validation Error\n\nParent device is lost")
        launch(self, kernel, *given, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(Commands, "launch", losing)
    init = Trainer.__init__

    def kept(self: Trainer, *given: object, **more: object) -> None:
        trainers.append(self)
        init(self, *given, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(Trainer, "__init__", kept)
    with pytest.raises(KernelError, match=r"failed while .*: Parent device is lost") as caught:
        trained(scene, replace(CONFIG, steps=6, mechanisms=()))
    assert "\n" not in str(caught.value)
    assert trainers[0].step == 3 and trainers[0].is_between_steps
