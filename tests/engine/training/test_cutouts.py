"""Steps that draw an object alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from roigs_engine.model.gaussians import NAMES
from roigs_engine.model.scene import PhotoMask, SfmScene
from roigs_engine.photos.mask_images import load_object_mask, write_mask
from roigs_engine.training.loss_masks import LossMasks
from roigs_engine.training.mechanisms.cutout_steps import EVERY, Cutouts
from tests.engine.synthetic_scene import BOX, make_scene, truth
from tests.engine.training.adam_from_gradients import AdamFromGradients
from tests.engine.training.mask_pixels import pixels_of


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    """The first photo has a mask: the left half of the picture."""
    folder = tmp_path_factory.mktemp("photos")
    found = make_scene(folder, views=4)
    mask = np.zeros((48, 64), bool)
    mask[:, :32] = True
    write_mask(folder / "mask.png", mask)
    small = np.where(mask, np.uint8(255), np.uint8(0))
    made = PhotoMask(digest="m", path=folder / "mask.png", remake=lambda: None, small=small)
    first = replace(found.images[0], objects={"thing": made})
    return replace(found, images=(first, *found.images[1:]))


def cutouts(scene: SfmScene) -> Cutouts:
    model = truth()
    owner = torch.where(model.in_box(BOX), 0, -1)
    return Cutouts(model, owner, [BOX], scene.images, seed=3)


def test_steps_are_a_function_of_the_seed(scene: SfmScene) -> None:
    one, other = cutouts(scene), cutouts(scene)
    drawn = set()
    for step in range(30):
        a, b = one.at(step), other.at(step)
        assert (a is None) == (b is None) == (step % EVERY == 0)
        if a is not None and b is not None:
            drawn.add(a.photo)
            assert a.photo == b.photo and torch.equal(a.background, b.background)
            assert torch.equal(a.shown, b.shown) and torch.equal(a.counted, b.counted)
            assert torch.equal(a.rows, truth().in_box(BOX).nonzero()[:, 0])
    assert drawn == {0, 1, 2, 3}


def test_a_mask_says_what_is_not_the_object_and_the_model_only_what_is(scene: SfmScene) -> None:
    for step in range(30):
        found = cutouts(scene).at(step)
        if found is None:
            continue
        silhouette = BOX.silhouette(
            scene.images[found.photo].camera, scene.images[found.photo].world_to_camera
        )
        assert not (found.counted.numpy() & ~silhouette).any()
        if found.photo == 0:
            mask = load_object_mask(scene.images[0], "thing")
            assert mask is not None
            assert np.array_equal(found.shown.numpy(), silhouette & mask)
            assert (found.counted & ~found.shown).any()
        else:
            assert torch.equal(found.counted, found.shown)
        photo = torch.full((48, 64, 3), 7, dtype=torch.uint8)
        target = found.target(photo)
        assert (target[found.shown] == 7).all()
        behind = (found.background * 255).round().to(torch.uint8)
        assert (target[~found.shown] == behind).all()


def test_boxes_without_masks_are_not_drawn(scene: SfmScene) -> None:
    model, other = truth(), replace(BOX, name="other")
    inside = model.in_box(BOX).nonzero()[:, 0]
    owner = torch.full((len(model),), -1)
    owner[inside[::2]], owner[inside[1::2]] = 0, 1
    steps = [Cutouts(model, owner, [BOX, other], scene.images, seed=3).at(k) for k in range(30)]
    found = [step for step in steps if step is not None]
    assert found
    assert all(torch.equal(step.rows, inside[::2]) for step in found)


def test_without_an_object_all_steps_are_ordinary(scene: SfmScene) -> None:
    nothing = torch.full((len(truth()),), -1)
    empty = Cutouts(truth(), nothing, [BOX], scene.images, seed=3)
    assert all(empty.at(step) is None for step in range(10))


def test_a_part_of_an_optimizer_takes_the_same_step() -> None:
    def optimizer() -> AdamFromGradients:
        tensors = {n: t.clone() for n, t in truth().tensors().items()}
        return AdamFromGradients({n: (t, 0.01) for n, t in tensors.items()})

    whole, parted = optimizer(), optimizer()
    rows = torch.arange(0, 300, 7)
    on = torch.zeros(300, dtype=torch.bool)
    on[rows] = True
    for _ in range(2):
        part = parted.part(rows)
        for name in NAMES:
            whole.parameters[name].grad[rows] = 1.5  # type: ignore[index]
            part.parameters[name].grad.fill_(1.5)  # type: ignore[union-attr]
        whole.step(on)
        part.step(torch.ones(len(rows), dtype=torch.bool))
        parted.put(part, rows)
    assert parted.step_count == whole.step_count == 2
    for name in NAMES:
        assert torch.equal(parted.parameters[name], whole.parameters[name])
        assert torch.equal(parted.exp_avg_sq[name], whole.exp_avg_sq[name])


def test_a_mask_of_the_object_takes_the_place_of_the_silhouette(scene: SfmScene) -> None:
    first, plain = scene.images[0], replace(scene.images[0], objects={})
    with_mask, without = (LossMasks([image], [BOX], [0])[0] for image in (first, plain))
    assert with_mask is not None and without is not None
    small, large = pixels_of(with_mask), pixels_of(without)
    assert small.sum() < large.sum()
    assert not (small & ~large).any()
    assert with_mask.loss_weight < without.loss_weight


def test_the_colour_behind_an_object_is_no_brighter_than_the_photos_white(scene: SfmScene) -> None:
    found = next(c for c in map(cutouts(scene).at, range(1, 9)) if c is not None)
    bright = replace(found, background=torch.ones(3), shown=torch.zeros_like(found.shown))
    photo = torch.zeros(*found.shown.shape, 3, dtype=torch.uint8)
    assert bright.target(photo).max() == 255
    assert bright.target(photo, 130).max() == 130
