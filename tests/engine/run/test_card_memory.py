"""The plan of a GPU's memory: what it says, what it refuses, and that it is about right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from roigs_engine.context import Context
from roigs_engine.cuda import card, pair_buffers
from roigs_engine.errors import SceneError
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.rasterize.cuda import CameraView
from roigs_engine.run import memory
from roigs_engine.run.definition import define_run
from roigs_engine.run.memory import plan_card
from roigs_engine.training import photo_order
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.stage_data import StageData
from roigs_engine.training.trainer import Trainer
from tests.engine.cuda.pretend_card import FAR, PretendCard, use
from tests.engine.cuda.shim import ShimProgram, compiled
from tests.engine.run.large_photos import CAMERA, GB, ONE, posed
from tests.engine.runs import tiny
from tests.engine.synthetic_scene import BOX, make_scene

SMALL = replace(CAMERA, width=96, height=64, fx=90.0, fy=90.0, cx=48.0, cy=32.0)


def test_what_is_expected_is_said() -> None:
    plan = plan_card(posed(2000), 100_000, 2_000_000, (24 * GB, 25 * GB))
    (message,) = plan.messages()
    assert "of 24.0 GB free (25.0 GB in all)" in message.text and "2,000,000" in message.text
    assert plan.photos == 6 * GB  # a quarter: not all are kept there
    assert plan_card(posed(3), 1000, 9000, (24 * GB, 25 * GB)).photos == 3 * ONE


def test_photos_leave_room_for_the_model_and_what_may_not_fit_is_warned_of() -> None:
    plan = plan_card(posed(2000), 100_000, 2_000_000, (11 * GB, 12 * GB))
    assert 0 < plan.photos < 11 * GB // 4 and len(plan.messages()) == 1
    plan = plan_card(posed(2000), 100_000, 9_000_000, (11 * GB, 12 * GB))
    warning = plan.messages()[-1]
    assert plan.photos == 0 and warning.level == "warning" and "--max-side" in warning.text


def test_what_cannot_fit_is_refused_with_what_does() -> None:
    card = (3 * GB, 8 * GB)
    with pytest.raises(SceneError, match=r"3\.0 GB of 8\.0 GB are free.*--max-side (\d+)") as error:
        plan_card(posed(9), 100_000, 200_000, card)
    side = int(str(error.value).split("--max-side ")[1].split()[0])
    assert 1000 < side < 6000 and "--device cpu" in str(error.value)
    fitting = replace(CAMERA, width=side, height=side * 2 // 3)
    plan_card(posed(9, fitting), 100_000, 200_000, card)
    with pytest.raises(SceneError, match=r"\. Close other programs that use the GPU, or train on"):
        plan_card(posed(9), 100_000_000, 100_000_000, card)


def test_a_run_on_a_gpu_has_such_a_plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = make_scene(tmp_path, views=4)
    run = define_run(tmp_path / "run", scene, [BOX], tiny("joint"))
    monkeypatch.setattr(memory, "card_memory", lambda device: (8 * GB, 9 * GB))
    plan = run.memory(Context(device="cuda:0"))
    assert plan.card is not None and "GPU memory" in plan.messages()[-1].text
    assert run.memory().card is None
    monkeypatch.setattr(memory, "card_memory", lambda device: (GB // 10_000, 9 * GB))
    with pytest.raises(SceneError, match="of GPU memory"):
        run.memory(Context(device="cuda:0"))


@pytest.mark.parametrize(("count", "grows"), [(600, False), (1500, True)])
def test_the_plan_is_what_tensors_take(
    count: int, grows: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between as much and twice as much, for the pairs that there are."""
    pretended, program, pairs = PretendCard(), ShimProgram(compiled()), []
    monkeypatch.setattr(card, "program", lambda device: program)
    use(monkeypatch, pretended)
    monkeypatch.setattr(pair_buffers, "LEAST_MARGIN", 0)
    list_tiles = CameraView.list_tiles

    def listed(view: CameraView, *, may_leave_slots: bool) -> None:
        pairs.append(view.pairs)
        list_tiles(view, may_leave_slots=may_leave_slots)

    monkeypatch.setattr(CameraView, "list_tiles", listed)
    images = posed(2, replace(SMALL))
    images = [replace(image, world_to_camera=shifted()) for image in images]
    points = np.random.default_rng(0).normal(size=(count, 3)) * 0.5
    config = TrainConfig(
        steps=99,
        mechanisms=(DensityControl(start=2, every=3, grad_threshold=0.0),) if grows else (),
    )
    with pretended:
        data = StageData(
            images=images,
            photos=BlackPhotos(),
            photo_at=photo_order.shuffled(range(2), 3),
            extent=1.0,
            device=FAR,
        )
        start = Gaussians.from_points(points, np.full((count, 3), 128, np.uint8))
        trainer = Trainer(start, data, config)
        for _ in range(4):
            trainer.train_step()
        end = len(trainer.gaussians)
    assert (end > 1.5 * count) == grows
    tiles = 96 * 64 / 16**2
    monkeypatch.setattr(memory, "CARD_CACHE", 1.0)
    at_most = memory.CARD_PER_PIXEL + memory.CARD_PER_PAIR * max(pairs) / tiles / 16**2
    monkeypatch.setattr(memory, "CARD_PER_PIXEL_AT_MOST", at_most)
    plan = plan_card(images, count, end, (GB, GB))
    assert 0.95 * pretended.most < plan.training < 2 * pretended.most


def shifted() -> NDArray[np.float64]:
    pose = np.eye(4)
    pose[2, 3] = 3.0
    return pose


class BlackPhotos:
    def __getitem__(self, index: int) -> NDArray[np.uint8]:
        return np.zeros((64, 96, 3), np.uint8)

    def prefetch(self, indices: Sequence[int]) -> Any:
        pass
