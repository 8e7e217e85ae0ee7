"""A training step does not wait for the GPU, and trains as if it did."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from roigs_engine.cuda import pair_buffers
from roigs_engine.cuda.pair_buffers import PairBuffer, PairBuffers
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.ownership import owners
from roigs_engine.model.scene import PhotoMask, SfmScene
from roigs_engine.photos.cache import PhotoCache
from roigs_engine.photos.mask_images import write_mask
from roigs_engine.training import photo_order
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.edits import morton_order
from roigs_engine.training.mechanisms import cutout_steps
from roigs_engine.training.mechanisms.cutout_steps import EVERY, Cutouts, CutoutSteps
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.mechanisms.idle_pruning import IdlePruning
from roigs_engine.training.mechanisms.masked_steps import MaskedSteps
from roigs_engine.training.mechanisms.model_averaging import ModelAveraging
from roigs_engine.training.mechanisms.warm_restarts import WarmRestarts
from roigs_engine.training.stage_data import StageData
from roigs_engine.training.trainer import Trainer
from tests.engine.cuda.pretend_card import FAR, PretendCard, use
from tests.engine.cuda.shim import ShimProgram
from tests.engine.synthetic_scene import BOX, make_scene

Inputs = Callable[[SfmScene], dict[str, Any]]
VIEWS = 2
CONFIG = TrainConfig(steps=100)
MASKS = MaskedSteps(whole_share=0.5, seeing=(0, 1))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    made = make_scene(tmp_path_factory.mktemp("photos"), views=VIEWS)
    return replace(made, images=tuple(image.scaled(0.5) for image in made.images))


@pytest.fixture
def card(shim: ShimProgram, monkeypatch: pytest.MonkeyPatch) -> PretendCard:
    made = PretendCard()
    use(monkeypatch, made)
    return made


def trainer_of(scene: SfmScene, config: TrainConfig = CONFIG, **more: Any) -> Trainer:
    data = StageData(
        images=scene.images,
        photos=more.pop("photos", PhotoCache(scene.images)),
        photo_at=photo_order.shuffled(range(VIEWS), 3),
        extent=scene.extent(),
        rois=[BOX],
        device=FAR,
        **more,
    )
    return Trainer(start(scene), data, config)


def start(scene: SfmScene) -> Gaussians:
    return Gaussians.from_points(scene.points[::30], scene.colors[::30])


def nothing_more(scene: SfmScene) -> dict[str, Any]:
    return {}


def boxes(scene: SfmScene) -> dict[str, Any]:
    return {"config": CONFIG.using(MASKS)}


class MaskedPhotos:
    """Photos of which the left part is ignored."""

    def __init__(self, scene: SfmScene) -> None:
        self._photos = PhotoCache(scene.images)

    def __getitem__(self, index: int) -> NDArray[np.uint8]:
        colours = self._photos[index]
        mask = np.full((*colours.shape[:2], 1), 255, np.uint8)
        mask[:, :10] = 0
        return np.concatenate([colours, mask], axis=2)

    def prefetch(self, indices: Sequence[int]) -> None:
        pass


def masked_photos(scene: SfmScene) -> dict[str, Any]:
    return {**boxes(scene), "photos": MaskedPhotos(scene)}


def backgrounds(scene: SfmScene) -> dict[str, Any]:
    return {"backgrounds": torch.zeros(VIEWS, 3).to(FAR)}


@pytest.mark.parametrize(
    "inputs",
    [
        *(nothing_more, boxes, masked_photos),
        pytest.param(backgrounds, marks=pytest.mark.slow),
    ],
)
def test_no_step_waits(scene: SfmScene, card: PretendCard, inputs: Inputs) -> None:
    with card:
        trainer = trainer_of(scene, **inputs(scene))
        trainer.step = 30
        for _ in range(12):  # every view is drawn whole and in part
            trainer.train_step()
        card.waits.clear()
        for _ in range(8):
            trainer.train_step()
        assert trainer.step == 50 and card.waits == []
        trainer.train_step()
    # every 50 steps the PSNR is read, when it is known that the steps before were done
    assert card.waits == ["a view's pairs"] * 2 + ["_local_scalar_dense"]


def test_steps_on_an_object_alone_do_not_wait(
    scene: SfmScene, card: PretendCard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_mask(tmp_path / "mask.png", np.ones((24, 32), bool))
    small = np.full((24, 32), 255, np.uint8)
    mask = PhotoMask(digest="m", path=tmp_path / "mask.png", remake=lambda: None, small=small)
    images = tuple(replace(image, objects={BOX.name: mask}) for image in scene.images)
    seen = replace(scene, images=images)
    model = start(scene)
    model = model.rows(morton_order(model.means))
    made = Cutouts(model, owners(model, [BOX]), [BOX], images, seed=3)
    with card:
        made._rows, made._device = [rows.to(FAR) for rows in made._rows], FAR
        monkeypatch.setattr(cutout_steps, "Cutouts", lambda *_: made)
        config = CONFIG.using(CutoutSteps())
        trainer = trainer_of(seen, config, labelled=lambda: (model, owners(model, [BOX])))
        trainer.step = 1
        for _ in range(2 * EVERY * VIEWS):
            trainer.train_step()
        card.waits.clear()
        for _ in range(2 * EVERY):
            trainer.train_step()
    assert card.waits == []


@pytest.mark.parametrize("inputs", [nothing_more, pytest.param(boxes, marks=pytest.mark.slow)])
def test_a_view_without_a_buffer_is_drawn_again(
    scene: SfmScene, card: PretendCard, monkeypatch: pytest.MonkeyPatch, inputs: Inputs
) -> None:
    """Steps that came after it as well: the bits are those of a training that waits each time."""
    real_buffer, small = PairBuffers.buffer, {5, 8, 9, 11}

    def buffer(self: PairBuffers, step: int, view: Hashable) -> PairBuffer:
        made = real_buffer(self, step, view)
        if made.capacity is None or step not in small:
            return made
        small.remove(step)
        self._needed[view] = -pair_buffers.LEAST_MARGIN + 9
        return real_buffer(self, step, view)

    monkeypatch.setattr(PairBuffers, "buffer", buffer)
    density = DensityControl(
        start=3, until=12, every=5, grad_threshold=1e-5, reset_every=7, prune_size=100.0
    )
    first = (MASKS, density) if inputs is boxes else (density, IdlePruning(every=4))
    last = WarmRestarts(count=1), ModelAveraging(steps=10)
    config = replace(CONFIG, steps=14, mechanisms=(*first, *last))
    states, steps = [], 0
    real = Trainer.train_step

    def counted(self: Trainer) -> None:
        nonlocal steps
        steps += 1
        real(self)

    monkeypatch.setattr(Trainer, "train_step", counted)
    for with_buffers in (False, True):
        use(monkeypatch, card, buffers=with_buffers)
        with card:
            trainer = trainer_of(scene, **(inputs(scene) | {"config": config}))
            assert trainer.run()
            losses = {photo: list(last) for photo, last in trainer.health._recent.items()}
            states.append({**trainer.state_dict(), "losses": losses})
            assert len(trainer.gaussians)
    assert not small and steps > 2 * config.steps + 3  # those after them were done again as well
    first, second = (dict(leaves(state)) for state in states)
    assert first.keys() == second.keys()
    for name, value in first.items():
        if "seconds" not in name:
            assert same(value, second[name]), name


def leaves(state: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """The leaves of nested dicts, by path."""
    if isinstance(state, dict):
        for key, value in state.items():
            yield from leaves(value, f"{name}/{key}")
    else:
        yield name, state


def same(one: Any, other: Any) -> bool:
    if isinstance(one, Tensor):
        return torch.equal(one, other)
    return bool(one == other or (one != one and other != other))
