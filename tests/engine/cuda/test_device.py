"""Training through the paths that a card uses, on the CPU."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from roigs_engine.context import QUIET, Context
from roigs_engine.cuda import device
from roigs_engine.cuda.device import CPU
from roigs_engine.cuda.photos import DevicePhotos
from roigs_engine.errors import GpuMemoryError, KernelError
from roigs_engine.model.gaussians import NAMES, Gaussians
from roigs_engine.model.ownership import nearest_owner, owners
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import SfmScene
from roigs_engine.photos.cache import PhotoCache
from roigs_engine.rasterize import RenderOutput, rasterize
from roigs_engine.rasterize.inputs import BackwardStep
from roigs_engine.run.definition import define_run
from roigs_engine.run.stage_folder import StageFolder
from roigs_engine.run.strategies import plan_run
from roigs_engine.training import stage_data as stage_data_module
from roigs_engine.training import trainer
from roigs_engine.training.checkpoint import save_checkpoint
from roigs_engine.training.mechanisms.density_control import RunningDensityControl
from roigs_engine.training.mechanisms.idle_pruning import IdlePruning
from roigs_engine.training.trainer import Trainer
from tests.engine import synthetic_scene
from tests.engine.cuda.short import CONFIG, trained
from tests.engine.runs import tiny
from tests.engine.synthetic_scene import BOX, make_scene, stage_data
from tests.engine.training.adam_from_gradients import AdamFromGradients
from tests.engine.training.reference_loss import photo_loss


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"), views=6)


# --- training ---


def without_kernels(patch: pytest.MonkeyPatch) -> None:
    """A training step in plain torch."""

    def plain(*arguments: Any, backward_step: BackwardStep, **options: Any) -> RenderOutput:
        output = rasterize(*arguments, backend="reference", **options)
        optimizer: AdamFromGradients = backward_step.take.__self__  # type: ignore[attr-defined]
        engine = torch.autograd.Variable._execution_engine  # type: ignore[attr-defined]
        output.image.register_hook(
            lambda _: engine.queue_callback(lambda: optimizer.step(output.visible[0]))
        )
        return output

    patch.setattr(trainer, "rasterize", plain)
    patch.setattr(trainer, "photo_loss", partial(photo_loss, backend="reference"))
    patch.setattr(trainer, "VisibleAdam", partial(AdamFromGradients, reference=True))


def weights(trainer: Trainer) -> torch.Tensor:
    """The largest blending weights that pruning has seen."""
    return trainer.state_dict()["mechanisms"]["idle_pruning"]["weight"]


def test_steps_without_kernels_are_those_with_them(
    scene: SfmScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(CONFIG, mechanisms=(IdlePruning(every=1),))
    kernels = trained(scene, config)
    without_kernels(monkeypatch)
    plain = trained(scene, config)
    assert float(plain._metrics.loss) == pytest.approx(float(kernels._metrics.loss), rel=1e-4)
    assert torch.allclose(weights(plain), weights(kernels), atol=1e-3)
    for name in NAMES:
        ours, truth = getattr(plain.gaussians, name), getattr(kernels.gaussians, name)
        # Quaternions of round Gaussians: Adam steps by the sign of a gradient that is zero.
        assert (ours - truth).abs().max() < (1e-2 if name == "quats" else 1e-3), name


def test_masked_steps_without_kernels_are_those_with_them(
    scene: SfmScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A card gets photo and mask as one picture."""
    mask = np.zeros((48, 64, 1), np.uint8)
    mask[5:40, 20:] = 255

    class Masked(PhotoCache):
        def __getitem__(self, index: int) -> NDArray[np.uint8]:
            return np.dstack([super().__getitem__(index), mask])

    sent: list[tuple[int, ...]] = []

    def upload(pixels: NDArray[np.uint8]) -> Callable[[], torch.Tensor]:
        sent.append(pixels.shape)
        return lambda: torch.from_numpy(pixels)

    monkeypatch.setattr(synthetic_scene, "PhotoCache", Masked)  # of `stage_data`
    config = replace(CONFIG, mechanisms=())
    kernels = trained(scene, config)
    without_kernels(monkeypatch)
    monkeypatch.setattr(
        stage_data_module,
        "photos_on",
        lambda _, photos, limit: DevicePhotos(photos, upload, limit=1 << 20),
    )
    plain = trained(scene, config)
    assert sent and set(sent) == {(48, 64, 4)}
    assert float(plain._metrics.loss) == pytest.approx(float(kernels._metrics.loss), rel=1e-4)
    assert torch.allclose(plain.gaussians.means, kernels.gaussians.means, atol=1e-3)


def test_densifying_without_kernels_gives_as_good_a_model(
    scene: SfmScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which Gaussians split depends on the last bit; how many, and how well it fits, does not."""
    kernels = trained(scene)
    without_kernels(monkeypatch)
    plain = trained(scene)
    assert len(plain.gaussians) == pytest.approx(len(kernels.gaussians), rel=0.05)
    assert len(plain.gaussians) > 100
    assert float(plain._metrics.loss) == pytest.approx(float(kernels._metrics.loss), rel=0.1)


def test_a_step_reads_nothing_back(scene: SfmScene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between edits no tensor becomes a number or a list, which on a card would be waited for."""
    config = replace(CONFIG, steps=20, mechanisms=())
    without_kernels(monkeypatch)
    start = Gaussians.from_points(scene.points[::6], scene.colors[::6])
    steps = Trainer(start, stage_data(scene), config)
    steps.train_step()
    # The reference rasterizer does read back: a rendering made before stands in for it.
    image = steps.gaussians.means.sum() * 0 + torch.rand(1, 48, 64, 3)
    count = len(start)
    output = SimpleNamespace(
        image=image,
        visible=torch.ones(1, count) > 0,
        grad2d=torch.rand(1, count),
        max_weight=None,
        surface=None,
    )
    monkeypatch.setattr(trainer, "rasterize", lambda *_, **__: output)

    def read(tensor: torch.Tensor, *_: Any) -> None:
        raise AssertionError("a tensor was read")

    for name in ("__bool__", "__float__", "__int__", "item", "tolist", "nonzero", "__index__"):
        monkeypatch.setattr(torch.Tensor, name, read)
    steps.train_step()


def test_a_checkpoint_goes_on_on_any_device(scene: SfmScene) -> None:
    """Its tensors are on the CPU, and are taken to the trainer's device."""
    state = trained(scene).state_dict()
    moved = device.on_device({"a": {"b": torch.ones(2), "c": 3}}, torch.device("meta"))
    assert moved["a"]["b"].device.type == "meta" and moved["a"]["c"] == 3
    for value in (*state["parameters"].values(), *state["optimizer"]["exp_avg"].values()):
        assert value.device == CPU
    assert isinstance(state["loss"], float)


def test_the_device_is_no_part_of_a_stage(scene: SfmScene, tmp_path: Path) -> None:
    run = define_run(tmp_path, scene, [BOX], tiny("joint"))
    plans = [plan_run(run, (), Context(device=device)) for device in ("cpu", "cuda:0")]
    first, second = ([stage.fingerprint for stage in plan.stages] for plan in plans)
    assert first == second


def test_boxes_own_the_same_on_every_device() -> None:
    generator = torch.Generator().manual_seed(0)
    count = 500
    means = torch.randn(count, 3, generator=generator)
    zeros = torch.zeros(count)
    model = Gaussians(
        means=means,
        quats=torch.zeros(count, 4),
        log_scales=means,
        logit_opacities=zeros,
        sh=torch.zeros(count, 1, 3),
    )
    turn = np.eye(4)
    turn[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]
    turned = replace(BOX, name="turned", world_to_box=turn, half_extents=np.array([1.0, 0.4, 0.9]))
    rois: list[OrientedBox] = [BOX, turned]
    expected = nearest_owner(means.numpy().astype(np.float64), rois)
    assert set(expected) == {-1, 0, 1}
    assert owners(model, rois).tolist() == expected.tolist()


# --- memory ---


def test_a_full_card_is_one_line_and_keeps_the_steps_before(
    scene: SfmScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = stage_data(scene)
    start = Gaussians.from_points(scene.points[::6], scene.colors[::6])
    stage = StageFolder(name="scene", folder=tmp_path / "scene", fingerprint="f")
    before = Trainer(start, data, CONFIG)
    for _ in range(3):
        before.train_step()
    save_checkpoint(stage._checkpoint, before.state_dict(), "f")
    draws = 0

    def full(*arguments: Any, **options: Any) -> Any:
        nonlocal draws
        draws += 1
        if draws > 2:
            raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB")
        return rasterize(*arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(trainer, "rasterize", full)
        with pytest.raises(KernelError) as caught:
            stage.train(lambda: start, data, CONFIG, QUIET)
    said = str(caught.value)
    assert "memory" in said and "step 5" in said and "64x48" in said and "\n" not in said
    assert re.search(r"\d+ Gaussians", said) and "--max-side" in said
    heard: list[Any] = []
    ended = stage.train(lambda: start, data, CONFIG, Context(emit=heard.append)).gaussians
    assert any(getattr(event, "text", "") == "scene: resumes at step 5." for event in heard)
    never_full = Trainer(start, data, CONFIG)
    assert never_full.run()
    for name, tensor in never_full.gaussians.tensors().items():
        assert torch.equal(getattr(ended, name), tensor), name


@pytest.mark.parametrize("part", ["observe", "edit"])
def test_memory_that_is_full_after_a_step_leaves_the_checkpoint(
    part: str, scene: SfmScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The model has changed, what belongs to the step has not: this is no state to go on from."""
    data = stage_data(scene)
    start = Gaussians.from_points(scene.points[::6], scene.colors[::6])
    stage = StageFolder(name="scene", folder=tmp_path / "scene", fingerprint="f")
    save_checkpoint(stage._checkpoint, Trainer(start, data, CONFIG).state_dict(), "f")
    saved = {path.name: path.read_bytes() for path in stage.folder.iterdir()}

    def full(*_: Any) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB")

    monkeypatch.setattr(RunningDensityControl, part, full)
    with pytest.raises(GpuMemoryError):
        stage.train(lambda: start, data, CONFIG, QUIET)
    assert {path.name: path.read_bytes() for path in stage.folder.iterdir()} == saved


# --- photos ---


def test_photos_stay_on_the_device_as_far_as_they_fit() -> None:
    sent: list[int] = []

    class Cache:
        def __getitem__(self, index: int) -> np.ndarray:
            return np.full((4, 5, 3), index, dtype=np.uint8)

        def prefetch(self, indices: Any) -> None:
            pass

    def upload(pixels: np.ndarray) -> Any:
        sent.append(int(pixels[0, 0, 0]))
        return lambda: torch.from_numpy(pixels)

    photos = DevicePhotos(Cache(), upload, limit=2 * 60 + 59)
    for _ in range(3):
        for index in range(3):
            photos.prefetch([(index + 1) % 3, (index + 2) % 3])
            assert photos[index].shape == (4, 5, 3) and int(photos[index][0, 0, 0]) == index
    # Sent once each, in the order of two threads; the third each time.
    assert sent.count(0) == sent.count(1) == 1 and set(sent) == {0, 1, 2}
