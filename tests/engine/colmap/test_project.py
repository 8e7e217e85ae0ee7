"""Reading COLMAP projects: layouts, names, sizes, photos left out, points, errors."""

from __future__ import annotations

import contextlib
import random
import shutil
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from PIL import Image

from roigs_engine.colmap.model_files import read_model
from roigs_engine.colmap.project import load_colmap
from roigs_engine.colmap.records import CAMERA_MODELS
from roigs_engine.context import Context
from roigs_engine.errors import ConfigError, SceneError
from roigs_engine.formats.events import Event, Message
from roigs_engine.model.scene import Camera, SfmScene
from tests.engine.synthetic_colmap import Project, camera, ring, write_project


def assert_same(scene: SfmScene, project: Project, names: list[str] | None = None) -> None:
    """Poses, points and observations are those that were written."""
    names = project.names if names is None else names
    assert [image.name for image in scene.images] == sorted(names)
    np.testing.assert_allclose(scene.points, project.points, atol=1e-12)
    for image in scene.images:
        index = project.names.index(image.name)
        np.testing.assert_allclose(image.world_to_camera, project.poses[index], atol=1e-12)
        seen = np.flatnonzero(np.isfinite(project.project(index)).all(axis=1))
        np.testing.assert_array_equal(image.point_indices, seen)


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


# --- folders and names ----------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["sparse/0", "sparse", ".", "0"])
def test_model_folders(tmp_path: Path, model: str) -> None:
    project = write_project(tmp_path, model=model)
    assert_same(load_colmap(tmp_path), project)
    assert_same(load_colmap(tmp_path / model), project)
    assert_same(load_colmap(str(tmp_path / model), images=tmp_path / "images"), project)


def test_the_model_with_most_photos_is_taken(tmp_path: Path) -> None:
    write_project(tmp_path, names=["a.png"], model="sparse/0")
    write_project(tmp_path, names=["a.png", "b.png", "c.png"], model="sparse/1", binary=False)
    write_project(tmp_path, names=["a.png", "b.png"], model="sparse/10")
    events: list[Event] = []
    scene = load_colmap(tmp_path, context=Context(emit=events.append))
    assert len(scene.images) == 3
    texts = [event.text for event in events if isinstance(event, Message)]
    assert any("3 models" in text and "sparse/1 with 3 photos" in text for text in texts)


def test_a_model_that_only_claims_to_have_most_photos_is_not_taken(tmp_path: Path) -> None:
    write_project(tmp_path, names=["a.png", "b.png"], model="sparse/0")
    write_project(tmp_path, names=["a.png"], model="sparse/1")
    path = tmp_path / "sparse/1/images.bin"
    path.write_bytes(struct.pack("<Q", 1 << 50) + path.read_bytes()[8:])
    (tmp_path / "sparse/²").mkdir()  # a digit, but no number
    assert len(load_colmap(tmp_path).images) == 2


@pytest.mark.parametrize("params", [(100.0, 0.0, 45, 40), (100.0, -1.0, 45, 40), (1e300, 90, 0, 0)])
def test_cameras_without_a_focal_length(tmp_path: Path, params: tuple[float, ...]) -> None:
    write_project(tmp_path, binary=False)
    line = f"1 PINHOLE 96 72 {' '.join(map(str, params))}\n"
    (tmp_path / "sparse/0/cameras.txt").write_text(line)
    with pytest.raises(SceneError, match=r"cameras\.txt"):
        load_colmap(tmp_path)


def test_reading_takes_memory_as_the_file_has_bytes(tmp_path: Path) -> None:
    count = 100_000
    write_project(tmp_path)
    point = struct.pack("<Q3d3BdQ", 1, 0.1, 0.2, 0.3, 9, 9, 9, 0.5, 0)
    path = tmp_path / "sparse/0/points3D.bin"
    path.write_bytes(struct.pack("<Q", count) + count * point)
    tracemalloc.start()
    assert len(read_model(path.parent).points) == count
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5 * path.stat().st_size + (8 << 20)


@pytest.mark.parametrize("binary", [True, False])
def test_names_in_any_script(tmp_path: Path, binary: bool) -> None:
    names = ["a b/with space.png", "[x] (1).png", "くまモン/写真 一.png", "déjà.png", "a.b/c.d.png"]
    folder = tmp_path / "projet été [1]"
    project = write_project(folder, names=names, binary=binary)
    assert_same(load_colmap(folder), project)


def test_names_that_differ_in_case_slash_or_accents(tmp_path: Path) -> None:
    project = write_project(tmp_path, names=["a.jpg", "sub/b.png", "de\u0301ja\u0300.png"])
    photos = tmp_path / "images"
    (photos / "a.jpg").rename(photos / "a.JPG")
    (photos / "de\u0301ja\u0300.png").rename(photos / "d\u00e9j\u00e0.png")
    images_bin = tmp_path / "sparse/0/images.bin"
    images_bin.write_bytes(images_bin.read_bytes().replace(b"sub/b.png", b"sub\\b.png"))
    scene = load_colmap(tmp_path)
    assert_same(scene, project)
    assert not scene.skipped
    assert (photos / "a.JPG").samefile(scene.image("a.jpg").path)


def test_names_that_lead_out_of_the_folder_find_nothing(tmp_path: Path) -> None:
    write_project(tmp_path, names=["a.png", "bb/c.png"])
    (tmp_path / "c.png").write_bytes((tmp_path / "images/a.png").read_bytes())
    images_bin = tmp_path / "sparse/0/images.bin"
    images_bin.write_bytes(images_bin.read_bytes().replace(b"bb/c.png", b"../c.png"))
    assert load_colmap(tmp_path).skipped["missing on disk"] == ("../c.png",)


@pytest.mark.parametrize("folder", ["images_2", "images_4", "images_8"])
def test_reduced_photo_folders(tmp_path: Path, folder: str) -> None:
    factor = int(folder[-1])
    big = camera(width=963, height=721, params=[1000.0, 900.0, 470.0, 400.0])
    write_project(tmp_path, cameras=[big], images=None)
    (tmp_path / "images").mkdir()  # empty: passed over
    (tmp_path / folder).mkdir()
    size = (round(963 / factor), 721 // factor)
    for name in "abc":
        Image.new("RGB", size).save(tmp_path / folder / f"{name}.png")
    image = load_colmap(tmp_path).images[0]
    found = image.camera
    assert (found.width, found.height) == size
    assert found.fx == pytest.approx(1000 * size[0] / 963, rel=1e-12)
    assert found.cy == pytest.approx(400 * size[1] / 721, rel=1e-12)


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


def test_orientation_tags_are_ignored(tmp_path: Path) -> None:
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
    assert str(tmp_path / "images") in caught.value.hint and "'a.png'" in caught.value.hint
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


# --- points and observations ----------------------------------------------------------------------


def test_a_model_without_tracks(tmp_path: Path) -> None:
    write_project(tmp_path, tracks=False)
    scene = load_colmap(tmp_path)
    assert not scene.has_tracks and len(scene.points) == 40
    assert all(len(image.point_indices) == 0 for image in scene.images)


def test_observations_from_the_points_side_alone(tmp_path: Path) -> None:
    for binary in (True, False):
        folder = tmp_path / str(binary)
        project = write_project(folder, binary=binary)
        bare = write_project(tmp_path / "bare", binary=binary, tracks=False)
        name = "images.bin" if binary else "images.txt"
        shutil.copy(bare.folder / "sparse/0" / name, folder / "sparse/0" / name)
        scene = load_colmap(folder)
        assert scene.has_tracks
        assert_same(scene, project)


def test_dangling_and_repeated_observations(tmp_path: Path) -> None:
    """Points taken out by hand stay named in images; a photo may see one point twice."""
    project = write_project(tmp_path, binary=False)
    points_txt, images_txt = (tmp_path / "sparse/0" / f"{n}.txt" for n in ("points3D", "images"))
    lines = [line for line in points_txt.read_text().splitlines() if not line.startswith("#")]
    points_txt.write_text("\n".join(line for line in lines if int(line.split()[0]) % 2) + "\n")
    rows = [line for line in images_txt.read_text().splitlines() if not line.startswith("#")]
    rows[1] += " 1.5 1.5 7 3 3 -1"
    images_txt.write_text("\r\n".join(rows))
    scene = load_colmap(tmp_path)
    np.testing.assert_allclose(scene.points, project.points[::2], atol=1e-12)
    seen = np.flatnonzero(np.isfinite(project.project(0)).all(axis=1))
    np.testing.assert_array_equal(scene.images[0].point_indices, seen[seen % 2 == 0] // 2)


def test_points_without_a_position_are_left_out(tmp_path: Path) -> None:
    points = np.array([[0.0, 0.1, 0.2], [np.nan, 0, 0], [0.3, 0.1, 0.0], [1e300, 0, 0]])
    write_project(tmp_path, points=points)
    events: list[Event] = []
    scene = load_colmap(tmp_path, context=Context(emit=events.append))
    np.testing.assert_array_equal(scene.points, points[[0, 2]])
    assert scene.images[0].point_indices.tolist() == [0, 1]
    assert any("2 3D points" in event.text for event in events if isinstance(event, Message))


@pytest.mark.parametrize("binary", [True, False])
def test_no_points(tmp_path: Path, binary: bool) -> None:
    write_project(tmp_path, points=np.empty((0, 3)), binary=binary)
    with pytest.raises(SceneError, match="has no 3D points"):
        load_colmap(tmp_path)


def test_points_with_negative_ids_are_named(tmp_path: Path) -> None:
    path = write_project(tmp_path, binary=False).folder / "sparse" / "0" / "points3D.txt"
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    negative = [f"-{line}" for line in lines]
    path.write_text("\n".join([*negative[:1], *lines[1:]]), encoding="utf-8")
    events: list[Event] = []
    assert len(load_colmap(tmp_path, context=Context(emit=events.append)).points) == len(lines) - 1
    texts = [event.text for event in events if isinstance(event, Message)]
    assert "Skipped 1 3D point: 1 with a negative id." in texts
    path.write_text("\n".join(negative), encoding="utf-8")
    with pytest.raises(SceneError, match=f"{len(lines)} with a negative id") as caught:
        load_colmap(tmp_path)
    assert caught.value.hint


@pytest.mark.parametrize("name", ["cameras.txt", "images.txt", "points3D.txt"])
def test_a_text_model_in_utf_16_is_named(tmp_path: Path, name: str) -> None:
    path = write_project(tmp_path, binary=False).folder / "sparse" / "0" / name
    path.write_text(path.read_text(encoding="utf-8"), encoding="utf-16")
    with pytest.raises(SceneError, match=rf"{name}.*UTF-16 text; save it as UTF-8"):
        load_colmap(tmp_path)


def test_no_photos_in_the_model(tmp_path: Path) -> None:
    write_project(tmp_path, names=[])
    with pytest.raises(SceneError, match="has no posed photos"):
        load_colmap(tmp_path)


# --- damage ---------------------------------------------------------------------------------------


def test_missing_folders_and_files(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="is not a folder"):
        load_colmap(tmp_path / "nothing")
    with pytest.raises(SceneError, match="has no COLMAP model"):
        load_colmap(tmp_path)
    write_project(tmp_path)
    (tmp_path / "sparse/0/points3D.bin").unlink()
    with pytest.raises(SceneError, match=r"points3D\.bin"):
        load_colmap(tmp_path)


@pytest.mark.parametrize("stem", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("binary", [True, False])
def test_damaged_files_never_end_in_a_traceback(tmp_path: Path, stem: str, binary: bool) -> None:
    """Cut, flipped and overwritten files load or raise a SceneError, at once."""
    write_project(tmp_path, names=["a.png"], binary=binary)
    path = tmp_path / "sparse/0" / (stem + (".bin" if binary else ".txt"))
    good, dice = path.read_bytes(), random.Random(stem)
    for kind in range(150):
        bad = bytearray(good)
        at = dice.randrange(len(bad))
        if kind % 3 == 0:
            del bad[at:]
        elif kind % 3 == 1:
            bad[at] ^= 1 << dice.randrange(8)
        else:
            bad[at : at + 8] = bytes(dice.choice((0, 255, 31)) for _ in range(8))
        path.write_bytes(bad)
        with contextlib.suppress(SceneError):
            load_colmap(tmp_path)


@pytest.mark.parametrize("stem", ["cameras", "images", "points3D"])
def test_every_cut_of_a_binary_file_is_noticed(tmp_path: Path, stem: str) -> None:
    write_project(tmp_path, names=["a.png"], points=np.zeros((2, 3)))
    path = tmp_path / "sparse/0" / f"{stem}.bin"
    good = path.read_bytes()
    for length in range(len(good)):
        path.write_bytes(good[:length])
        with pytest.raises(SceneError, match=f"{stem}\\.bin"):
            read_model(path.parent)
