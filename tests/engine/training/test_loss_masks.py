"""Steps of the ROI stage that look at the boxes' silhouettes alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from roigs_engine.errors import ConfigError
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.rasterize.tiles import active_tiles
from roigs_engine.training.config import PlannedViews, TrainConfig
from roigs_engine.training.loss_masks import LossMask, LossMasks
from roigs_engine.training.losses import photo_loss
from roigs_engine.training.mechanisms.box_density_control import BoxDensityControl
from roigs_engine.training.mechanisms.idle_pruning import IdlePruning
from roigs_engine.training.mechanisms.masked_steps import MaskedSteps
from roigs_engine.training.mechanisms.model_averaging import ModelAveraging
from roigs_engine.training.mechanisms.surroundings_rate import SurroundingsRate
from tests.engine.training.mask_pixels import pixels_of

CAMERA = Camera(width=150, height=100, fx=100.0, fy=100.0, cx=75.0, cy=50.0)
BOX = OrientedBox.between("thing", (-0.3, -0.2, 3.7), (0.3, 0.2, 4.3))


def photo(pose: np.ndarray | None = None) -> PosedImage:
    pose = np.eye(4) if pose is None else pose
    return PosedImage(
        name="a.jpg",
        path=Path("a.jpg"),
        camera=CAMERA,
        world_to_camera=pose,
        point_indices=np.zeros(0, dtype=np.int64),
    )


def test_a_mask_is_the_silhouettes_tiles_and_a_rim() -> None:
    mask = LossMasks([photo()], [BOX], [0])[0]
    assert mask is not None
    silhouette = BOX.silhouette(CAMERA, np.eye(4))
    pixels = pixels_of(mask).numpy()
    assert pixels[silhouette].all()
    ys, xs = np.nonzero(silhouette)
    for reach in (-16, 16):  # a whole tile around every pixel of the silhouette
        assert pixels[ys, np.clip(xs + reach, 0, CAMERA.width - 1)].all()
        assert pixels[np.clip(ys + reach, 0, CAMERA.height - 1), xs].all()
    assert 0 < mask.loss_weight < 0.6
    x0, y0, x1, y1 = mask.tiles.shown
    assert not pixels[:y0].any() and not pixels[y1:].any()
    assert not pixels[:, :x0].any() and not pixels[:, x1:].any()
    assert torch.equal(mask.weights, pixels_of(mask)[y0:y1, x0:x1].float())
    assert mask.loss_weight == pytest.approx(float(pixels_of(mask).float().mean()))


def test_only_tiles_in_which_a_pixel_counts_are_drawn() -> None:
    mask = LossMasks([photo()], [BOX], [0])[0]
    assert mask is not None
    counted = torch.zeros(CAMERA.height, CAMERA.width, dtype=torch.bool)
    counted[50, 75] = counted[0, 0] = True  # the latter is outside of the mask
    found = mask.counting(counted)
    assert found.shown == mask.tiles.shown
    expected = active_tiles(CAMERA.width, CAMERA.height, counted & pixels_of(mask))
    assert found.mask is not None and expected.mask is not None
    assert int(found.mask.sum()) == int(expected.mask.sum()) == 1
    row, column = (int(k) for k in found.mask.nonzero()[0])
    left, top, _, _ = found.rectangle
    assert (left + column, top + row) == expected.rectangle[:2]


def test_a_photo_without_a_box_has_no_mask() -> None:
    behind = np.diag([-1.0, 1.0, -1.0, 1.0])
    assert LossMasks([photo(behind)], [BOX], [0])[0] is None


def test_a_pixel_weights_as_hard_as_in_the_whole_photo() -> None:
    """The L1 term's gradient in the mask is that of the whole photo."""
    mask = LossMasks([photo()], [BOX], [0])[0]
    assert mask is not None
    rng = torch.Generator().manual_seed(1)
    image = torch.rand(CAMERA.height, CAMERA.width, 3, generator=rng, requires_grad=True)
    target = torch.randint(0, 256, image.shape, generator=rng, dtype=torch.uint8)
    (whole,) = torch.autograd.grad(photo_loss(image, target, ssim_weight=0).loss, image)
    part = photo_loss(mask.crop(image), mask.crop(target), ssim_weight=0, weights=mask.weights)
    (gradient,) = torch.autograd.grad(part.loss * mask.loss_weight, image)
    assert torch.allclose(gradient[pixels_of(mask)], whole[pixels_of(mask)], rtol=1e-4)
    assert not gradient[~pixels_of(mask)].any()


def test_weighted_photos_pull_alike_from_near_and_far() -> None:
    poses = [np.eye(4) for _ in range(4)]
    for pose, back in zip(poses, (-3.0, 0.0, 6.0, -20.0), strict=True):  # the last sees no box
        pose[2, 3] = back
    photos = [photo(pose) for pose in poses]

    def masks(weighting: float, drawn: Sequence[int] = range(4)) -> list[LossMask]:
        several = LossMasks(photos, [BOX], drawn, view_weighting=weighting)
        return [mask for k in range(4) if (mask := several[k]) is not None]

    shares = np.array([float(pixels_of(mask).float().mean()) for mask in masks(0)])
    assert len(shares) == 3 and shares[0] > 2 * shares[2]
    for weighting in (0.0, 0.5, 1.0, 1.5):
        weights = np.array([mask.loss_weight for mask in masks(weighting)])
        assert np.log(weights / shares).mean() == pytest.approx(0, abs=1e-6)
        assert weights[0] / weights[2] == pytest.approx((shares[0] / shares[2]) ** (1 - weighting))
    # Photos that no such step draws have no say.
    first_two = np.array([mask.loss_weight for mask in masks(1.0, drawn=[0, 1])])[:2]
    assert np.log(first_two / shares[:2]).mean() == pytest.approx(0, abs=1e-6)


@pytest.mark.filterwarnings("error")
def test_boxes_that_no_photo_shows() -> None:
    assert LossMasks([photo()], [BOX], (), view_weighting=1.9)[0] is not None


def test_a_tiny_mask_does_not_outweigh_all_others() -> None:
    poses = [np.eye(4) for _ in range(4)]
    for pose, back in zip(poses, (-3.0, -3.0, -3.0, 12.0), strict=True):
        pose[2, 3] = back
    several = LossMasks([photo(pose) for pose in poses], [BOX], range(4), view_weighting=1.9)
    weights = [mask.loss_weight for k in range(4) if (mask := several[k]) is not None]
    shares = [float(pixels_of(mask).float().mean()) for k in range(4) if (mask := several[k])]
    assert weights[3] == pytest.approx(2 * np.exp(np.mean(np.log(shares))))
    assert weights[0] < weights[3]


def test_what_masks_save_is_spent_on_whole_photos() -> None:
    near, far = np.eye(4), np.eye(4)
    near[2, 3], far[2, 3] = -4.0, 12.0  # in the box, and far from it
    masks = MaskedSteps(whole_share=0.25, reinvested=0.5)
    config = TrainConfig(steps=400, mechanisms=(masks,))

    def planned(*poses: NDArray[np.float64]) -> tuple[float, float]:
        """Steps with a mask, and on whole photos."""
        images = [photo(pose) for pose in poses]
        views = PlannedViews(images=images, rois=[BOX], seen=lambda roi: images)
        found = config.planned(views)
        share = found.of(MaskedSteps).whole_share
        return (1 - share) * found.steps, share * found.steps

    shares = LossMasks([photo(near), photo(far)], [BOX], ()).shares([0, 1])
    assert shares[0] == 1 and shares[1] < 0.5
    assert planned(near) == pytest.approx((300, 100))  # a box that fills the photos
    saved = 300 * (1 - shares.mean())
    assert planned(near, far) == pytest.approx((300, 100 + saved / 2), abs=1)


@pytest.mark.parametrize("budget", [0.0, 3.0])
def test_steps_that_are_given_back_do_not_densify(budget: float) -> None:
    near, far = np.eye(4), np.eye(4)
    near[2, 3], far[2, 3] = -4.0, 12.0
    images = [photo(pose) for pose in (near, far)]
    density = BoxDensityControl(start=20, until=130, budget=budget)
    masks = MaskedSteps(whole_share=0.25, reinvested=0.5)
    config = TrainConfig(steps=400, mechanisms=(density, masks, ModelAveraging(steps=40)))
    found = config.planned(PlannedViews(images=images, rois=[BOX], seen=lambda roi: images))
    assert found.steps > 450
    assert found.of(BoxDensityControl) == replace(
        density, budgets=found.of(BoxDensityControl).budgets
    )
    assert found.of(ModelAveraging).steps == round(found.steps / 10)


def test_settings_that_do_not_go_together_are_refused() -> None:
    config = TrainConfig(steps=10, mechanisms=(MaskedSteps(),))
    with pytest.raises(ConfigError, match="idle_pruning needs steps that use whole photos"):
        config.using(IdlePruning(every=100))
    with pytest.raises(ConfigError, match="view_weighting is -1"):
        config.using(MaskedSteps(view_weighting=-1.0))
    with pytest.raises(ConfigError, match="whole_share is 1"):
        config.using(MaskedSteps(whole_share=1.0))
    with pytest.raises(ConfigError, match="factor is -1"):
        config.using(SurroundingsRate(factor=-1.0))
    with pytest.raises(ConfigError, match="surroundings_rate needs masked_steps"):
        TrainConfig(steps=10, mechanisms=(SurroundingsRate(),))
