"""A scene's exposures: EXIF that the photos confirm, that they refute, and none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.app.inputs import load_scene
from roigs_engine.colmap.exposures import with_exposures
from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import QUIET, Context
from roigs_engine.formats.events import Event, Message
from roigs_engine.formats.run_files import CACHE, EXPOSURES
from roigs_engine.model.scene import SfmScene
from roigs_engine.photos.decode import load_photo
from roigs_engine.photos.exposures import white
from roigs_engine.photos.mask_images import load_masked
from roigs_engine.requests.runs import Train
from tests.engine.colmap.drifting import POINTS, STOPS, project


def load(folder: Path, *, pixels: bool = True) -> tuple[SfmScene, list[str]]:
    events: list[Event] = []
    context, cache = Context(emit=events.append), folder / "cache"
    scene = load_colmap(folder, cache=cache, pixels=pixels, context=context)
    scene = with_exposures(scene, cache, pixels=pixels, context=context)
    return scene, [event.text for event in events if isinstance(event, Message)]


def exposures(scene: SfmScene) -> np.ndarray:
    return np.array([image.exposure for image in scene.images])


def brightness(scene: SfmScene) -> np.ndarray:
    return np.array([load_photo(image).mean() for image in scene.images])


def test_exif_levels_photos(tmp_path: Path) -> None:
    project(tmp_path, STOPS, STOPS)
    scene, texts = load(tmp_path)
    assert np.abs(exposures(scene) - STOPS).max() < 0.01
    assert np.ptp(brightness(scene)) < 3
    assert any("differ by 2.2 stops (EXIF)" in text for text in texts)
    cameras, _ = load(tmp_path, pixels=False)  # a plan without pixels knows the same photos
    assert [i.digest for i in cameras.images] == [i.digest for i in scene.images]
    plain = load_colmap(tmp_path, cache=tmp_path / "cache")
    assert not exposures(plain).any() and np.ptp(brightness(plain)) > 50
    assert {i.digest for i in plain.images}.isdisjoint(i.digest for i in scene.images if i.exposure)


def test_exif_of_photos_that_were_made_equal_is_not_believed(tmp_path: Path) -> None:
    project(tmp_path, np.zeros(8), STOPS)
    scene, texts = load(tmp_path)
    assert not exposures(scene).any()
    assert any("EXIF is not used" in text for text in texts)


@pytest.mark.parametrize("count", [2, 150])
def test_exposures_of_no_scene_are_not_believed(tmp_path: Path, count: int) -> None:
    """Too few points were no check: photos became black."""
    wrong = np.where(np.arange(8) == 3, -31.0, 0.0)
    project(tmp_path, np.zeros(8), wrong, POINTS[:count])
    scene, texts = load(tmp_path)
    assert not exposures(scene).any()
    assert any("differ by 31.0 stops, as in no scene: EXIF is not used" in text for text in texts)


def test_few_points_cannot_check_exif(tmp_path: Path) -> None:
    project(tmp_path, STOPS, STOPS, POINTS[:2])
    scene, texts = load(tmp_path)
    assert np.abs(exposures(scene) - STOPS).max() < 0.01
    assert any("(EXIF)" in text for text in texts)


def test_points_tell_exposures_without_exif(tmp_path: Path) -> None:
    project(tmp_path, STOPS, None)
    scene, texts = load(tmp_path)
    assert np.abs(exposures(scene) - STOPS).max() < 0.05
    assert any("(points)" in text for text in texts)


@pytest.mark.parametrize("shown", [np.zeros(8), STOPS / 25])
def test_equal_exposures_change_nothing(tmp_path: Path, shown: np.ndarray) -> None:
    project(tmp_path, shown, shown)
    scene, texts = load(tmp_path)
    plain = load_colmap(tmp_path, cache=tmp_path / "cache")
    assert [i.digest for i in scene.images] == [i.digest for i in plain.images]
    assert not any("xposure" in text for text in texts)


def test_a_damaged_answer_in_the_cache_is_made_again(tmp_path: Path) -> None:
    project(tmp_path, STOPS, STOPS)
    first, _ = load(tmp_path)
    (tmp_path / CACHE / EXPOSURES).write_text('{"key": "x", "stops": 3}')
    again, _ = load(tmp_path)
    assert np.array_equal(exposures(first), exposures(again))


def test_what_is_clipped_in_a_brighter_photo_has_its_white(tmp_path: Path) -> None:
    project(tmp_path, STOPS, STOPS)
    path = tmp_path / "images" / "d.jpg"
    with Image.open(path) as opened:
        exif, pixels = opened.getexif(), np.array(opened)
    pixels[:, :48] = 255
    Image.fromarray(pixels).save(path, quality=95, exif=exif)
    image = load(tmp_path)[0].image("d.jpg")
    taken = load_masked(image)
    assert image.exposure > 0 and taken.shape[2] == 3
    assert (taken[:, :40] == white(image.exposure)).all()
    assert (taken[:, 56:] < white(image.exposure)).any()


def test_requests_level_photos_unless_they_refuse(tmp_path: Path) -> None:
    project(tmp_path, STOPS, STOPS)
    asked = load_scene(Train(scene=tmp_path, run_dir=tmp_path), QUIET, tmp_path / "cache")
    assert np.abs(exposures(asked) - STOPS).max() < 0.01
    refused = load_scene(
        Train(scene=tmp_path, run_dir=tmp_path, no_exposures=True), QUIET, tmp_path / "cache"
    )
    assert not exposures(refused).any()
