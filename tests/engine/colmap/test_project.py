"""Reading COLMAP projects: layouts, names, sizes, photos left out, points, errors."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from PIL import Image

from roigs_engine.colmap.project import load_colmap
from roigs_engine.colmap.records import CAMERA_MODELS
from roigs_engine.context import Context
from roigs_engine.errors import ConfigError, SceneError
from roigs_engine.formats.events import Event, Message
from roigs_engine.model.scene import Camera
from roigs_engine.photos.files import PhotoFolder
from tests.engine.synthetic_colmap import assert_same, camera, ring, write_project


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("rigs", [True, False])
def test_binary_and_text_with_and_without_rigs(tmp_path: Path, binary: bool, rigs: bool) -> None:
    project = write_project(tmp_path, binary=binary, rigs=rigs)
    files = {path.stem for path in (tmp_path / "sparse/0").iterdir()}
    assert ("rigs" in files) == rigs and ("frames" in files) == rigs
    scene = load_colmap(tmp_path)
    assert_same(scene, project)
    assert scene.has_tracks and not scene.skipped
    assert scene.colors.dtype == np.uint8 and scene.colors[3].tolist() == [3, 100, 200]


def test_pinhole_keeps_focals_and_principal_point_exactly(tmp_path: Path) -> None:
    cameras = [
        camera(params=[100.0, 90.0, 45.1, 39.6]),
        camera("SIMPLE_PINHOLE", 90, 60, [77.25, 40.5, 33.125]),
    ]
    write_project(tmp_path, names=["a.png", "b.png"], cameras=cameras)
    first, second = load_colmap(tmp_path).images
    assert first.camera == Camera(width=96, height=72, fx=100.0, fy=90.0, cx=45.1, cy=39.6)
    assert second.camera == Camera(width=90, height=60, fx=77.25, fy=77.25, cx=40.5, cy=33.125)
    assert first.path == tmp_path / "images" / "a.png"  # not a copy


def test_the_folder_of_photos_stands_for_the_project(tmp_path: Path) -> None:
    project = write_project(tmp_path)
    assert_same(load_colmap(tmp_path / "images"), project)
    (tmp_path / "other" / "images").mkdir(parents=True)
    with pytest.raises(SceneError, match="images has no COLMAP model"):
        load_colmap(tmp_path / "other" / "images")


def test_zero_distortion_is_a_pinhole(tmp_path: Path) -> None:
    flat = camera("OPENCV", params=[100.0, 90.0, 40.0, 30.0, 0, 0, 0, 0])
    write_project(tmp_path, cameras=[flat])
    image = load_colmap(tmp_path).images[0]
    assert image.camera == Camera(width=96, height=72, fx=100.0, fy=90.0, cx=40.0, cy=30.0)
    assert image.path.parent == tmp_path / "images"


def test_poses_of_a_rig_with_two_cameras(tmp_path: Path) -> None:
    options = pycolmap.SyntheticDatasetOptions(
        num_rigs=1, num_cameras_per_rig=2, num_frames_per_rig=3, num_points3D=20
    )
    truth = pycolmap.synthesize_dataset(options)
    (tmp_path / "sparse").mkdir()
    truth.write(str(tmp_path / "sparse"))
    images = {image.name: image for image in truth.images.values()}
    for name, image in images.items():
        path = tmp_path / "images" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        size = (image.camera.width // 8, image.camera.height // 8)
        Image.new("RGB", size).save(path)
    scene = load_colmap(tmp_path)
    assert len(scene.images) == 6
    for image in scene.images:
        expected = images[image.name].cam_from_world().matrix()
        np.testing.assert_allclose(image.world_to_camera[:3], expected, atol=1e-9)


def test_camera_models_are_pycolmaps() -> None:
    members = pycolmap.CameraModelId.__members__
    for number, (name, parameters) in enumerate(CAMERA_MODELS):
        assert int(members[name].value) == number
        made = pycolmap.Camera.create_from_model_id(1, members[name], 100.0, 64, 48)
        assert len(made.params) == parameters, name


# --- sizes ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "size"),
    [
        ({"max_side": 48}, (48, 36)),
        ({"downscale": 2.5}, (38, 29)),
        ({"max_side": 500}, (96, 72)),
        ({"downscale": 1}, (96, 72)),
        ({"downscale": 2, "max_side": 20}, (20, 15)),
    ],
)
def test_sizes(tmp_path: Path, settings: dict[str, Any], size: tuple[int, int]) -> None:
    write_project(tmp_path)
    for image in load_colmap(tmp_path, **settings).images:
        assert image.camera == Camera(
            width=96, height=72, fx=100.0, fy=90.0, cx=96 * 0.47, cy=72 * 0.55
        ).resized(*size)


@pytest.mark.parametrize("settings", [{"downscale": 0.5}, {"max_side": 0}, {"downscale": np.nan}])
def test_sizes_out_of_range(tmp_path: Path, settings: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(settings))):
        load_colmap(tmp_path, **settings)


def test_rotation_tags_of_photos_that_fit_as_stored_are_ignored(tmp_path: Path) -> None:
    write_project(tmp_path, names=["a.jpg"])
    path = tmp_path / "images/a.jpg"
    photo = Image.open(path)
    exif = photo.getexif()
    exif[0x0112] = 6  # rotated by 90 degrees
    photo.save(path, exif=exif)
    assert load_colmap(tmp_path).images[0].camera.width == 96


# --- photos left out ------------------------------------------------------------------------------


def test_photos_left_out_are_named_by_reason(tmp_path: Path) -> None:
    names = ["a.png", "gone.png", "turned.png", "broken.png", "nowhere.png", "b.png"]
    project = write_project(tmp_path, names=names)
    photos = tmp_path / "images"
    (photos / "gone.png").unlink()
    Image.new("RGB", (72, 96)).save(photos / "turned.png")
    (photos / "broken.png").write_bytes(b"no picture")
    Image.new("RGB", (96, 72)).save(photos / "extra.png")
    (photos / "notes.txt").write_text("not a photo")
    images_bin = tmp_path / "sparse/0/images.bin"
    data = images_bin.read_bytes()
    start = data.index(b"nowhere.png") - 60  # quaternion, translation, camera id
    images_bin.write_bytes(data[:start] + struct.pack("<d", np.nan) + data[start + 8 :])
    events: list[Event] = []
    scene = load_colmap(tmp_path, context=Context(emit=events.append))
    assert_same(scene, project, ["a.png", "b.png"])
    assert scene.skipped == {
        "missing on disk": ("gone.png",),
        "wrong size": ("turned.png",),
        "unreadable": ("broken.png",),
        "without a pose": ("extra.png", "nowhere.png"),
    }
    assert sum(isinstance(event, Message) for event in events) == 4


def test_no_photo_left(tmp_path: Path) -> None:
    write_project(tmp_path, images="elsewhere")
    with pytest.raises(SceneError) as caught:
        load_colmap(tmp_path)
    assert "3 missing on disk" in caught.value.message
    assert str(tmp_path / "images") in caught.value.message
    assert str(tmp_path / "elsewhere") in caught.value.hint
    assert len(load_colmap(tmp_path, images=tmp_path / "elsewhere").images) == 3
    with pytest.raises(SceneError, match="is not a folder"):
        load_colmap(tmp_path, images=tmp_path / "nothing")


def test_one_name_twice(tmp_path: Path) -> None:
    write_project(tmp_path, names=["a.png", "b.png"])
    images_bin = tmp_path / "sparse/0/images.bin"
    images_bin.write_bytes(images_bin.read_bytes().replace(b"b.png\0", b"a.png\0"))
    scene = load_colmap(tmp_path)
    assert [image.name for image in scene.images] == ["a.png"]
    np.testing.assert_allclose(scene.images[0].world_to_camera, ring(2)[0], atol=1e-12)
    assert scene.skipped == {"twice in the model": ("a.png",), "without a pose": ("b.png",)}


def test_one_photo_under_many_spellings(tmp_path: Path) -> None:
    """Each spelling counted as a photo, with its own weight in training."""
    write_project(tmp_path, names=["d/a.png", "d/b1.png", "d/c123.png", "d/d4567.png"])
    (tmp_path / "images/link").symlink_to("d")
    images_bin = tmp_path / "sparse/0/images.bin"
    data = images_bin.read_bytes()
    spellings = ((b"d/b1.png", b"d//a.png"), (b"d/c123.png", b"link/a.png"))
    for old, new in (*spellings, (b"d/d4567.png", b"d/././a.png")):
        data = data.replace(old + b"\0", new + b"\0")
    images_bin.write_bytes(data)
    scene = load_colmap(tmp_path)
    assert [image.name for image in scene.images] == ["d/a.png"]
    assert scene.skipped["twice in the model"] == ("d/././a.png", "d//a.png", "link/a.png")


def test_why_photos_are_missing_is_looked_up_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It compares a name with all files: with 100,000 names, that took minutes."""
    write_project(tmp_path, names=["a.png", "b.png", "c.png", "d.png"])
    for name in ("b.png", "c.png", "d.png"):
        (tmp_path / "images" / name).unlink()
    asked = []

    def missing(folder: PhotoFolder, name: str) -> tuple[str, str]:
        asked.append(name)
        return why(folder, name)

    why = PhotoFolder.missing
    monkeypatch.setattr(PhotoFolder, "missing", missing)
    scene = load_colmap(tmp_path)
    assert scene.skipped == {"missing on disk": ("b.png", "c.png", "d.png")}
    assert asked == ["b.png"]
