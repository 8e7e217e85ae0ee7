"""Models of software that obeys the EXIF rotation of photos, and of software that does not."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from PIL import Image

from roigs_engine.colmap.model_files import read_model
from roigs_engine.colmap.photo_loader import stored_photo
from roigs_engine.colmap.photo_pixels import photo_pixels
from roigs_engine.colmap.project import load_colmap, model_turns
from roigs_engine.context import Context
from roigs_engine.errors import Stopped
from roigs_engine.formats.events import Event, Message
from roigs_engine.model.scene import SfmScene
from roigs_engine.photos.decode import decode, load_photo
from roigs_engine.photos.files import PhotoFolder
from roigs_engine.photos.mask_images import load_mask, load_object_mask
from roigs_engine.photos.mask_paths import MaskOptions
from tests.engine.synthetic_colmap import Project, camera, write_project

NAMES = [f"{index}.png" for index in range(6)]
POINTS = np.random.default_rng(1).uniform(-0.8, 0.8, (150, 3))
BACK = {  # turn -> what makes the stored pixels of the seen ones
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_90,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_270,
}


def colour_of(row: int) -> tuple[int, int, int]:
    """Of a point."""
    return 37 * row % 256, 91 * row % 256, 211 * row % 256


def painted(folder: Path, **settings: Any) -> tuple[Project, dict[str, np.ndarray]]:
    """A project whose photos show its points in their colours; and the photos."""
    project = write_project(folder, names=NAMES, points=POINTS, **settings)
    model = pycolmap.Reconstruction(str(folder / "sparse/0"))
    for row, key in enumerate(sorted(model.points3D)):
        model.points3D[key].color = np.array(colour_of(row), np.uint8)
    model.write(str(folder / "sparse/0"))
    rng = np.random.default_rng(2)
    seen = {}
    for index, name in enumerate(NAMES):
        cam = project.cameras[project.camera_of[index]]
        pixels = rng.integers(30, 50, (cam.height, cam.width, 3), dtype=np.uint8)
        for row, place in enumerate(project.project(index)):
            if np.isfinite(place).all():
                column, line = place.astype(int)
                part = pixels[max(0, line - 1) : line + 2, max(0, column - 1) : column + 2]
                part[:] = colour_of(row)
        seen[name] = pixels
        Image.fromarray(pixels).save(folder / "images" / name)
    return project, seen


def tag(path: Path, turn: int, *, turn_pixels: bool) -> None:
    exif = Image.Exif()
    exif[0x0112] = turn
    photo = Image.open(path)
    (photo.transpose(BACK[turn]) if turn_pixels else photo).save(path, exif=exif)


def load(folder: Path, **settings: Any) -> tuple[SfmScene, list[Message]]:
    events: list[Event] = []
    scene = load_colmap(folder, context=Context(emit=events.append), **settings)
    said = [e for e in events if isinstance(e, Message) and "EXIF" in e.text]
    return scene, said


def assert_shown(scene: SfmScene, right: Mapping[str, np.ndarray]) -> None:
    assert [image.name for image in scene.images] == list(right)
    for image in scene.images:
        np.testing.assert_array_equal(load_photo(image), right[image.name])


@pytest.mark.parametrize("turn", BACK)
def test_turned_photos_are_turned_in_whatever_way(tmp_path: Path, turn: int) -> None:
    """Also upside down or mirrored, where sizes are the same: then the points' colours tell."""
    _, seen = painted(tmp_path)
    for name in NAMES:
        tag(tmp_path / "images" / name, turn, turn_pixels=True)
    scene, (said,) = load(tmp_path)
    assert_shown(scene, seen)
    assert said.level == "info" and "6 of 6 photos turned" in said.text


@pytest.mark.parametrize("turn", [2, 3, 4])
def test_models_of_colmap_keep_the_stored_pixels(tmp_path: Path, turn: int) -> None:
    _, seen = painted(tmp_path)
    for name in NAMES[::2]:
        tag(tmp_path / "images" / name, turn, turn_pixels=False)
    scene, said = load(tmp_path)
    assert_shown(scene, seen)
    assert not said


@pytest.mark.parametrize("obeyed", [False, True])
def test_a_square_photo_on_its_side(tmp_path: Path, obeyed: bool) -> None:
    square = camera(width=80, height=80, params=[90.0, 90.0, 40.0, 40.0])
    _, seen = painted(tmp_path, cameras=[square])
    for name in NAMES[:3]:
        tag(tmp_path / "images" / name, 6, turn_pixels=obeyed)
    scene, said = load(tmp_path)
    assert_shown(scene, seen)
    assert len(said) == obeyed


@pytest.mark.parametrize("obeyed", [False, True])
def test_photos_on_their_side_decide_for_those_upside_down(tmp_path: Path, obeyed: bool) -> None:
    """Nothing but sizes can tell here: the photos are flat, and one way is right for all."""
    write_project(tmp_path, names=NAMES)
    tag(tmp_path / "images/0.png", 6, turn_pixels=obeyed)
    tag(tmp_path / "images/1.png", 3, turn_pixels=obeyed)
    scene, said = load(tmp_path)
    assert [image.turn for image in scene.images] == ([6, 3] if obeyed else [1, 1]) + [1] * 4
    if obeyed:
        assert "2 of 6 photos" in said[0].text and "0.png, 1.png" in said[0].text


def test_photos_that_nothing_decides_for_are_named(tmp_path: Path) -> None:
    write_project(tmp_path, names=NAMES)
    tag(tmp_path / "images/4.png", 3, turn_pixels=True)
    scene, (said,) = load(tmp_path)
    assert scene.image("4.png").turn == 1
    assert said.level == "warning" and "1 photo " in said.text and "4.png" in said.text


def test_distorted_photos_are_turned_before_they_are_undistorted(tmp_path: Path) -> None:
    lens = camera("SIMPLE_RADIAL", params=[100.0, 48.0, 36.0, 0.1])
    painted(tmp_path / "plain", cameras=[lens])
    painted(tmp_path / "turned", cameras=[lens])
    for name in NAMES:
        tag(tmp_path / "turned/images" / name, 8, turn_pixels=True)
    right, _ = load(tmp_path / "plain")
    found, _ = load(tmp_path / "turned")
    assert_shown(found, {image.name: load_photo(image) for image in right.images})


def test_a_turned_photo_has_a_digest_of_its_own(tmp_path: Path) -> None:
    """The cached copy of a photo as stored is not used for the turned one."""
    painted(tmp_path)
    scene, _ = load(tmp_path)
    stored = {image.name: image.digest for image in scene.images}
    for name in NAMES:
        tag(tmp_path / "images" / name, 3, turn_pixels=True)
    turned, _ = load(tmp_path)
    for image in turned.images:
        assert image.digest not in (stored[image.name], image.file_digest)


@pytest.mark.parametrize("drawn", ["as seen", "as stored"])
def test_masks_are_of_the_photo_as_seen_or_turned_with_it(tmp_path: Path, drawn: str) -> None:
    painted(tmp_path)
    mask = np.ones((72, 96), bool)
    mask[:20, :30] = False
    stored = Image.fromarray(mask)
    for name in NAMES:
        tag(tmp_path / "images" / name, 6, turn_pixels=True)
        for folder in ("masks", "masks/cup"):
            (tmp_path / folder).mkdir(exist_ok=True)
            turned = stored.transpose(BACK[6]) if drawn == "as stored" else stored
            turned.save(tmp_path / folder / f"{name}.png")
    scene, _ = load(tmp_path, masks=MaskOptions(boxes=("cup",)))
    for image in scene.images:
        np.testing.assert_array_equal(load_mask(image), mask)
        np.testing.assert_array_equal(load_object_mask(image, "cup"), mask)


def test_an_alpha_channel_is_turned_with_its_photo(tmp_path: Path) -> None:
    _, seen = painted(tmp_path)
    path = tmp_path / "images/0.png"
    alpha = np.full((72, 96), 255, np.uint8)
    alpha[:20, :30] = 0
    Image.fromarray(np.dstack([seen["0.png"], alpha])).save(path)
    tag(path, 6, turn_pixels=True)
    scene, _ = load(tmp_path)
    np.testing.assert_array_equal(load_mask(scene.image("0.png")), alpha > 0)


def test_pixels_that_a_person_draws_on_are_turned(tmp_path: Path) -> None:
    _, seen = painted(tmp_path)
    tag(tmp_path / "images/2.png", 7, turn_pixels=True)
    scene, _ = load(tmp_path, pixels=False)
    photo = photo_pixels(tmp_path / "sparse/0", scene.images)["2.png"]
    np.testing.assert_array_equal(photo.pixels(), seen["2.png"])
    assert photo.size == (96, 72)


def test_a_stop_between_photos_is_heard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    painted(tmp_path)
    looked = []

    def look(*args: Any) -> Any:
        looked.append(args)
        return stored_photo(*args)

    monkeypatch.setattr("roigs_engine.colmap.project.stored_photo", look)
    sparse, stop = tmp_path / "sparse/0", Context(should_stop=lambda: len(looked) > 1)
    with pytest.raises(Stopped):
        model_turns(read_model(sparse), sparse, PhotoFolder(tmp_path / "images"), stop)
    assert len(looked) == 2


def test_a_stop_while_photos_are_compared_is_heard(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    painted(tmp_path)
    for name in NAMES:
        tag(tmp_path / "images" / name, 3, turn_pixels=False)
    decoded = []

    def look(*args: Any) -> Any:
        decoded.append(args)
        return decode(*args)

    monkeypatch.setattr("roigs_engine.photos.decode.decode", look)
    sparse, stop = tmp_path / "sparse/0", Context(should_stop=lambda: len(decoded) > 1)
    with pytest.raises(Stopped):
        model_turns(read_model(sparse), sparse, PhotoFolder(tmp_path / "images"), stop)
    assert len(decoded) == 2
