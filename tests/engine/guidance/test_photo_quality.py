"""Blurred, dark and odd photos of a ball are found by what the others show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageFilter
from scipy.ndimage import map_coordinates, uniform_filter

from roigs_engine.colmap.lenses import undistorted_camera, undistorted_places
from roigs_engine.colmap.records import lens_from_words, lens_in_words
from roigs_engine.guidance import photo_quality
from roigs_engine.guidance.known import ELSEWHERE, KnownBox, known_box
from roigs_engine.guidance.pictures import from_photos
from roigs_engine.model.scene import PhotoMask, SfmScene
from roigs_engine.photos.mask_images import write_mask
from tests.engine.guidance.ball import BOX, CAMERA, RADIUS, VIEWS, ball_scene, pose_at

BLURRED, DARK, MISSING = 3, 8, 14
SMALL = np.zeros((0, 0), np.uint8)  # of a mask: unused here


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


def test_photos_with_lens_distortion_are_measured_where_they_show_the_patches(
    scene: SfmScene, known: KnownBox, tmp_path: Path
) -> None:
    """The photos' files are distorted, the cameras are pinholes."""
    lens = lens_from_words(
        f"SIMPLE_RADIAL {CAMERA.width} {CAMERA.height} {CAMERA.fx} {CAMERA.cx} {CAMERA.cy} 3.0"
    )
    pinhole, images = undistorted_camera(lens), []
    y, x = np.mgrid[: CAMERA.height, : CAMERA.width] + 0.5
    places = np.stack([x, y], axis=-1).reshape(-1, 2)
    for image in scene.images:
        if image.path.is_file():
            at = undistorted_places(lens, CAMERA, places).T[::-1] - 0.5
            whole = np.asarray(Image.open(image.path).convert("L")).astype(float)
            bent = map_coordinates(whole, at, order=1, mode="nearest").reshape(x.shape)
            grey = np.repeat(bent[..., None], 3, axis=2).round().astype(np.uint8)
            Image.fromarray(grey).save(tmp_path / image.name)
        words = {"distorted": True, "lens": lens_in_words(lens), "camera": pinhole}
        images.append(replace(image, path=tmp_path / image.name, **words))
    found = known_box(replace(scene, images=tuple(images)), BOX).quality
    assert found is not None and known.quality is not None
    both = np.isfinite(found.texture) & np.isfinite(known.quality.texture)
    straight = np.corrcoef(found.texture[both], known.quality.texture[both])[0, 1]
    flat = known_box(
        replace(scene, images=tuple(replace(i, distorted=False) for i in images)), BOX
    ).quality
    assert flat is not None
    both = np.isfinite(flat.texture) & np.isfinite(known.quality.texture)
    assert straight > 0.9 > np.corrcoef(flat.texture[both], known.quality.texture[both])[0, 1]


def test_ignored_pixels_are_not_measured(scene: SfmScene, tmp_path: Path) -> None:
    """A dark bar in front of one photo, which its mask ignores, changes nothing but its share."""
    number = 5
    bar = np.zeros((CAMERA.height, CAMERA.width), bool)
    bar[:, 25:105] = True
    write_mask(tmp_path / "mask.png", ~bar)
    mask = PhotoMask(digest="m", path=tmp_path / "mask.png", remake=lambda: None, small=SMALL)
    image = scene.images[number]
    photo = np.array(Image.open(image.path).convert("RGB"))
    photo[bar] = 20
    Image.fromarray(photo).save(tmp_path / image.name)
    barred = replace(image, path=tmp_path / image.name)
    exposures = []
    for shown in (image, replace(barred, mask=mask), barred):
        images = (*scene.images[:number], shown, *scene.images[number + 1 :])
        quality = known_box(replace(scene, images=images), BOX).quality
        assert quality is not None
        exposures.append(quality.exposure[number])
    assert exposures[1] == pytest.approx(exposures[0], abs=0.05)
    assert abs(exposures[2] - exposures[0]) > 0.5
