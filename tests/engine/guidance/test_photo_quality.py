"""Blurred, dark and odd photos of a ball are found by what the others show."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image, ImageFilter
from scipy.ndimage import map_coordinates, uniform_filter

from roigs_engine.guidance import photo_quality
from roigs_engine.guidance.known import ELSEWHERE, KnownBox, known_box
from roigs_engine.guidance.pictures import from_photos
from roigs_engine.model.scene import SfmScene
from tests.engine.guidance.ball import BOX, CAMERA, RADIUS, VIEWS, ball_scene, pose_at

BLURRED, DARK, MISSING = 3, 8, 14


def picture(pose: np.ndarray) -> np.ndarray:
    """(H, W) light of the ball with a texture that is fixed to it, on grey."""
    rng = np.random.default_rng(5)
    texture = rng.uniform(0.1, 0.9, (48, 48, 48))
    y, x = np.mgrid[: CAMERA.height, : CAMERA.width] + 0.5
    rays = np.stack([(x - CAMERA.cx) / CAMERA.fx, (y - CAMERA.cy) / CAMERA.fy, np.ones_like(x)], -1)
    rays = rays @ pose[:3, :3]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    eye = -pose[:3, :3].T @ pose[:3, 3]
    along = rays @ eye
    inner = along**2 - eye @ eye + RADIUS**2
    hit = inner > 0
    places = eye + rays * (-along - np.sqrt(np.maximum(inner, 0)))[..., None]
    cells = (places + 0.5).clip(0, 1) * 47
    values = map_coordinates(texture, cells.reshape(-1, 3).T, order=1).reshape(hit.shape)
    return np.where(hit, values, 0.5)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    folder = tmp_path_factory.mktemp("photos")
    made = ball_scene(folder=folder)
    for number, image in enumerate(made.images):
        light = picture(image.world_to_camera) * (0.35 if number == DARK else 1)
        photo = Image.fromarray(np.repeat((light * 255).astype(np.uint8)[..., None], 3, axis=2))
        if number == BLURRED:
            photo = photo.filter(ImageFilter.GaussianBlur(2))
        if number != MISSING:
            photo.save(image.path)
    return made


@pytest.fixture(scope="module")
def known(scene: SfmScene) -> KnownBox:
    return known_box(scene, BOX)


def test_the_blurred_photo_is_the_least_sharp(known: KnownBox) -> None:
    assert known.quality is not None
    sharp = known.quality.sharpness
    others = np.delete(sharp, [BLURRED, MISSING])
    assert np.nanargmin(sharp) == BLURRED
    assert sharp[BLURRED] < 0.7 and others.min() > 0.85


def test_the_dark_photo_is_exposed_less(known: KnownBox) -> None:
    assert known.quality is not None
    exposure = known.quality.exposure
    # The texture is sRGB: a factor of 0.35 there is more than three stops of light.
    assert exposure[DARK] < -2
    assert np.abs(np.delete(exposure, [DARK, MISSING])).max() < 0.4


def test_a_photo_that_cannot_be_read_is_named_and_counts_as_sharp(known: KnownBox) -> None:
    assert known.quality is not None
    assert known.quality.unreadable == (f"{MISSING:02d}.png",)
    column = [image.name for image in known.map.images].index(f"{MISSING:02d}.png")
    assert np.isnan(known.quality.sharpness[column])
    assert known.map.sharpness[column] == 1


def test_a_blurred_photo_tells_less(scene: SfmScene, known: KnownBox) -> None:
    assert known.map.value < known_box(scene, BOX, look=False).map.value


def test_an_expected_picture_is_the_nearest_photo_from_the_new_place(known: KnownBox) -> None:
    blank = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    there = known.map.images[5]
    same = from_photos(blank, known.map, CAMERA, there.world_to_camera)
    photo = np.asarray(Image.open(there.path).convert("RGB"))
    assert np.abs(same.astype(int) - photo).mean() < 1
    middle = slice(37, 53), slice(52, 68)
    between = pose_at(2 * np.pi * 5.4 / VIEWS)
    found = uniform_filter(from_photos(blank, known.map, CAMERA, between)[..., 0] / 255, 3)[middle]
    truth = uniform_filter(picture(between), 3)[middle]
    assert np.corrcoef(found.ravel(), truth.ravel())[0, 1] > 0.5
    assert not from_photos(blank, known.map, CAMERA, pose_at(0.0, 0.01, 3.0)).any()


def test_of_many_photos_fewer_places_are_measured(
    scene: SfmScene, known: KnownBox, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The memory does not grow with the photos, and the measures stay what they were."""
    assert known.quality is not None
    places = len(known.map.patches) + ELSEWHERE
    monkeypatch.setattr(photo_quality, "MOST", places * len(scene.images) // 3)
    fewer = known_box(scene, BOX).quality
    assert fewer is not None
    measured = np.isfinite(fewer.texture).sum()
    assert 0 < measured < np.isfinite(known.quality.texture).sum() / 2
    assert np.nanargmin(fewer.sharpness) == BLURRED
    assert np.nanmax(np.abs(fewer.sharpness - known.quality.sharpness)) < 0.15
    assert fewer.exposure[DARK] < -2
