"""Test photos with masks: ignored pixels are in no number, and objects have a number."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.evaluation.evaluate import evaluate
from roigs_engine.evaluation.report import format_markdown
from roigs_engine.evaluation.scores import Evaluation
from roigs_engine.evaluation.views import EvaluatedModel
from roigs_engine.model.scene import PhotoMask, SfmScene
from roigs_engine.photos.decode import load_photo
from roigs_engine.photos.mask_images import write_mask
from roigs_engine.rasterize.view import render_view
from tests.engine.synthetic_scene import BOX, make_scene, truth

TEST = ("001.png", "004.png")


def masked(scene: SfmScene, folder: Path, mask: np.ndarray) -> SfmScene:
    path = folder / "mask.png"
    write_mask(path, mask)
    small = np.where(mask, np.uint8(255), np.uint8(0))
    made = PhotoMask(digest="m", path=path, remake=lambda: write_mask(path, mask), small=small)
    return replace(scene, images=tuple(replace(image, mask=made) for image in scene.images))


def scores(scene: SfmScene) -> Evaluation:
    worse = truth()
    worse.sh[::2] *= 0.9
    models = [
        EvaluatedModel(name="Full Scene", gaussians=worse, seconds=1.0),
        EvaluatedModel(name="Joint", gaussians=truth(), seconds=1.0),
    ]
    return evaluate(models, scene, TEST, [BOX])


def test_what_ignored_pixels_show_is_not_measured(tmp_path: Path) -> None:
    mask = np.ones((48, 64), bool)
    mask[10:30, 20:40] = False  # half of the box
    clean = make_scene(tmp_path, views=6)
    plain, before = scores(clean), scores(masked(clean, tmp_path, mask))
    for name in TEST:
        image = clean.image(name)
        pixels = load_photo(image)
        pixels[~mask] = np.random.default_rng(1).integers(0, 256, (400, 3))
        Image.fromarray(pixels).save(image.path)
    spoiled, after = scores(clean), scores(masked(clean, tmp_path, mask))
    for row, same in zip(before.roi("thing").rows, after.roi("thing").rows, strict=True):
        one, other = asdict(row), asdict(same)
        for key in ("roi_flip", "views"):
            one.pop(key), other.pop(key)
        assert one == other
        for view, again in zip(row.views, same.views, strict=True):
            assert (view.roi_psnr, view.roi_ssim) == (again.roi_psnr, again.roi_ssim)
    first = after.roi("thing").rows[1]
    assert first.roi_psnr is not None and first.roi_psnr > 40 < first.image_psnr
    assert spoiled.roi("thing").rows[1].image_psnr < 25
    sizes = [r.roi("thing").views[0].silhouette_pixels for r in (plain, after)]
    assert 0 < sizes[1] < sizes[0]
    assert after.masked == 2 and "2 photos with a mask" in format_markdown(after)
    assert Evaluation.from_dict(after.to_dict()) == after
    assert "masked" not in plain.to_dict() and "mask:" not in format_markdown(plain)


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_box_that_masks_hide_has_no_scores(tmp_path: Path, share: float) -> None:
    mask = np.zeros((48, 64), bool)
    mask[0, 0] = True  # something of each photo counts
    mask[:, : round(64 * share)] = True
    result = scores(masked(make_scene(tmp_path, views=6), tmp_path, mask))
    views = result.roi("thing").views
    assert len(views) == (2 if share else 0)


def test_what_a_mask_shows_as_the_object_has_a_column(tmp_path: Path) -> None:
    clean = make_scene(tmp_path, views=6)
    half = np.zeros((48, 64), bool)
    half[:, :32] = True
    path = tmp_path / "object.png"
    write_mask(path, half)
    small = np.where(half, np.uint8(255), np.uint8(0))
    made = PhotoMask(digest="o", path=path, remake=lambda: None, small=small)
    images = tuple(
        replace(image, objects={"thing": made}) if image.name == TEST[0] else image
        for image in clean.images
    )
    found = scores(replace(clean, images=images))
    worse, _ = found.roi("thing").rows
    first, second = worse.views
    assert second.mask_psnr is None and worse.mask_psnr == first.mask_psnr
    image = clean.image(TEST[0])
    shown = half & BOX.silhouette(image.camera, image.world_to_camera)
    model = truth()
    model.sh[::2] *= 0.9
    picture = render_view(model, image.camera, image.world_to_camera).image.numpy()
    error = ((picture - load_photo(image) / 255.0)[shown] ** 2).mean()
    assert first.mask_psnr == pytest.approx(-10 * np.log10(error), abs=1e-3)
    text = format_markdown(found)
    assert "mask PSNR (dB)" in text
    assert "on 1 of 2 photos; the others have no mask of it" in text
    assert Evaluation.from_dict(found.to_dict()) == found
    plain = scores(clean)
    assert "mask_psnr" not in str(plain.to_dict()) and "mask PSNR" not in format_markdown(plain)
    assert Evaluation.from_dict(plain.to_dict()) == plain
