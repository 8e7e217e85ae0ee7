"""Undistorted photos and their pinholes: geometry, borders, sizes, the cache."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from roigs_engine.colmap import lenses, undistort
from roigs_engine.colmap.library import pycolmap_module
from roigs_engine.colmap.project import load_colmap
from roigs_engine.colmap.records import CAMERA_MODELS, ModelCamera
from roigs_engine.context import Context
from roigs_engine.errors import EngineError, RunFolderError, SceneError
from roigs_engine.formats.events import Event, StageStarted
from roigs_engine.model.scene import SfmScene
from roigs_engine.photos.decode import load_photo
from tests.engine.colmap.distorted import CX, CY, DISTORTED, FX, FY, F, distorted, grid
from tests.engine.synthetic_colmap import camera, write_project

PLAIN = {"SIMPLE_PINHOLE", "PINHOLE", "EQUIRECTANGULAR"}


def dot_errors(scene: SfmScene) -> np.ndarray:
    """Distances in pixels from where the pinhole projects points to the dots' centres there."""
    image = scene.images[0]
    found = image.camera
    local = scene.points @ image.world_to_camera[:3, :3].T + image.world_to_camera[:3, 3]
    expected = local[:, :2] / local[:, 2:] * (found.fx, found.fy) + (found.cx, found.cy)
    photo = load_photo(image)[..., 0].astype(float) - 20
    radius = max(3, round(5 * found.fx / F))
    errors = []
    for x, y in expected:
        left, top = int(x) - radius, int(y) - radius
        window = photo[max(top, 0) : top + 2 * radius + 1, max(left, 0) : left + 2 * radius + 1]
        if window.shape != (2 * radius + 1, 2 * radius + 1) or top < 0 or left < 0:
            continue
        weights = window.clip(0) + 1e-9
        assert weights.max() > 60, "no dot where the pinhole projects a point"
        rows, columns = np.mgrid[: len(window), : len(window)] + 0.5
        centre = [(weights * at).sum() / weights.sum() for at in (columns + left, rows + top)]
        errors.append(np.hypot(centre[0] - x, centre[1] - y))
    return np.array(errors)


def test_every_model_is_covered() -> None:
    assert set(DISTORTED) | PLAIN == {name for name, _ in CAMERA_MODELS}


@pytest.mark.parametrize("model", DISTORTED)
def test_points_project_to_the_same_features(tmp_path: Path, model: str) -> None:
    distorted(tmp_path, model)
    errors = dot_errors(load_colmap(tmp_path))
    assert len(errors) >= 15
    assert errors.max() < 0.25


@pytest.mark.parametrize("settings", [{"max_side": 120}, {"downscale": 1.3}, {"max_side": 80}])
def test_the_same_at_smaller_sizes(tmp_path: Path, settings: dict[str, Any]) -> None:
    """Also where the photo is shrunk before it is undistorted."""
    distorted(tmp_path)
    scene = load_colmap(tmp_path, **settings)
    errors = dot_errors(scene)
    assert len(errors) >= 15 and errors.max() < 0.25
    with Image.open(scene.images[0].path) as stored:
        assert stored.size == (scene.images[0].camera.width, scene.images[0].camera.height)
    if "max_side" in settings:
        assert max(stored.size) == settings["max_side"]


def test_the_same_on_resampled_photos(tmp_path: Path) -> None:
    distorted(tmp_path)
    photo = Image.open(tmp_path / "images/a.png").resize((120, 90), Image.Resampling.BOX)
    photo.save(tmp_path / "images/a.png")
    scene = load_colmap(tmp_path)
    assert scene.images[0].camera.width <= 125
    assert dot_errors(scene).max() < 0.25


@pytest.mark.parametrize("model", DISTORTED)
@pytest.mark.parametrize("settings", [{}, {"max_side": 80}])
def test_no_black_borders(tmp_path: Path, model: str, settings: dict[str, Any]) -> None:
    distorted(tmp_path, model)
    Image.new("RGB", (240, 180), (200, 200, 200)).save(tmp_path / "images/a.png")
    assert load_photo(load_colmap(tmp_path, **settings).images[0]).min() >= 198


def test_a_fisheye_without_distortion_is_not_taken_for_a_pinhole(tmp_path: Path) -> None:
    fisheye = camera("OPENCV_FISHEYE", 240, 180, [FX, FY, CX, CY, 0, 0, 0, 0])
    write_project(tmp_path, names=["a.png"], cameras=[fisheye], points=grid(), dots=True)
    assert dot_errors(load_colmap(tmp_path)).max() < 0.25


def test_several_cameras_of_different_models(tmp_path: Path) -> None:
    cameras = [
        camera(width=240, height=180, params=[FX, FY, CX, CY]),
        camera("SIMPLE_RADIAL", 180, 240, [F, CY, CX, 0.05]),
        camera("FOV", 240, 180, DISTORTED["FOV"]),
    ]
    names = ["a.png", "b/c.png", "d.png", "e.png"]
    write_project(tmp_path, names=names, cameras=cameras, points=grid(), dots=True, arc=0.6)
    scene = load_colmap(tmp_path, cache=tmp_path / "cache")
    assert [image.name for image in scene.images] == names
    assert len({image.camera for image in scene.images}) == 3
    for image in scene.images:
        assert dot_errors(scene.select([image.name])).max() < 0.25
        assert (image.path.parent == tmp_path / "cache/undistorted") == (image.name[0] not in "ae")


def test_a_panorama_is_left_out(tmp_path: Path) -> None:
    panorama = camera("EQUIRECTANGULAR", 240, 120, [240.0, 120.0])
    cameras = [camera(width=240, height=180, params=[FX, FY, CX, CY]), panorama]
    write_project(tmp_path, names=["a.png", "b.png"], cameras=cameras, tracks=False)
    scene = load_colmap(tmp_path)
    assert scene.skipped == {"EQUIRECTANGULAR cannot be undistorted": ("b.png",)}
    (tmp_path / "images/a.png").unlink()
    with pytest.raises(SceneError, match="EQUIRECTANGULAR cannot be undistorted"):
        load_colmap(tmp_path)


# --- cache ----------------------------------------------------------------------------------------


def stages(folder: Path, **settings: Any) -> tuple[SfmScene, list[int]]:
    """The scene and how many photos each undistortion stage announced."""
    events: list[Event] = []
    scene = load_colmap(folder, context=Context(emit=events.append), **settings)
    started = [event for event in events if isinstance(event, StageStarted)]
    return scene, [event.total for event in started if event.stage == "undistort"]


def test_the_cache_is_reused(tmp_path: Path) -> None:
    distorted(tmp_path)
    cache = tmp_path / "cache"
    scene, announced = stages(tmp_path, cache=cache)
    assert announced == [1]
    before = scene.images[0].path.stat().st_mtime_ns
    again, announced = stages(tmp_path, cache=cache)
    assert announced == []
    assert again.images[0].path == scene.images[0].path
    assert again.images[0].path.stat().st_mtime_ns == before
    assert again.images[0].camera == scene.images[0].camera
    assert len(list((cache / "undistorted").iterdir())) == 1  # nothing half-written beside it


def test_the_cache_follows_photo_camera_and_size(tmp_path: Path) -> None:
    distorted(tmp_path)
    cache = tmp_path / "cache"
    assert stages(tmp_path, cache=cache)[1] == [1]
    assert stages(tmp_path, cache=cache, max_side=100)[1] == [1]
    photo = tmp_path / "images/a.png"
    os.utime(photo, ns=(1, 1))
    assert stages(tmp_path, cache=cache)[1] == []  # touched, but the same
    distorted(tmp_path, "FOV", images=None)
    assert stages(tmp_path, cache=cache)[1] == [1]
    assert stages(tmp_path, cache=cache)[1] == []


def test_cameras_alone(tmp_path: Path) -> None:
    distorted(tmp_path)
    scene, announced = stages(tmp_path, max_side=100, pixels=False)
    assert announced == []
    assert scene.images[0].path == tmp_path / "images/a.png"
    assert scene.images[0].camera == load_colmap(tmp_path, max_side=100).images[0].camera


def test_a_photo_that_breaks_off_is_left_out(tmp_path: Path) -> None:
    made = camera("OPENCV", 240, 180, DISTORTED["OPENCV"])
    write_project(tmp_path, names=["a.jpg", "b.jpg"], cameras=[made])
    path = tmp_path / "images/b.jpg"
    path.write_bytes(path.read_bytes()[:-200])
    scene = load_colmap(tmp_path)
    assert [image.name for image in scene.images] == ["a.jpg"]
    assert scene.skipped == {"unreadable": ("b.jpg",)}


def test_a_cache_that_cannot_be_written(tmp_path: Path) -> None:
    distorted(tmp_path)
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RunFolderError, match="Cannot write"):
        load_colmap(tmp_path, cache=tmp_path / "file")


def test_without_pycolmap_pinholes_still_load(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_project(tmp_path / "plain")
    distorted(tmp_path / "bent", "SIMPLE_RADIAL")
    monkeypatch.setitem(__import__("sys").modules, "pycolmap", None)
    pycolmap_module.cache_clear()
    lenses.undistorted_camera.cache_clear()
    try:
        assert len(load_colmap(tmp_path / "plain").images) == 3
        with pytest.raises(EngineError, match="needs pycolmap"):
            load_colmap(tmp_path / "bent")
    finally:
        pycolmap_module.cache_clear()


def noise(width: int = 240, height: int = 180) -> np.ndarray:
    """(H, W, 3) uint8, with as much detail as pixels can have."""
    values = np.random.default_rng(1).integers(0, 255, (height, width, 3))
    return values.astype(np.uint8)


def test_pixels_stay_as_they_are_where_nothing_is_distorted() -> None:
    """Even if the picture loses an odd number of columns: half a pixel aside would blur it."""
    for params in ([FX, FY, CX, CY, 1e-7, 0, 0, 0], [FX, FY, CX + 0.3, CY, 0, 0, 1e-5, 0]):
        lens = ModelCamera(model="OPENCV", width=240, height=180, params=tuple(params))
        pinhole = lenses.undistorted_camera(lens)
        left, top = round(lens.params[2] - pinhole.cx), round(lens.params[3] - pinhole.cy)
        kept = noise()[top : top + pinhole.height, left : left + pinhole.width]
        made = lenses.undistorted_pixels(noise(), lens)
        assert np.abs(made.astype(int) - kept)[2:-2, 2:-2].mean() < 2


def test_detail_survives() -> None:
    """Of a distorted photo: linear interpolation keeps half of the contrast of fine patterns."""
    lens = ModelCamera(model="OPENCV", width=240, height=180, params=tuple(DISTORTED["OPENCV"]))
    rng = np.random.default_rng(1)
    waves = 127 + 100 * np.sin(np.arange(240) * 2 * np.pi / 4 + rng.uniform(0, 6))
    photo = np.repeat(np.tile(waves, (180, 1))[..., None], 3, axis=2).astype(np.uint8)
    sharp = lenses.undistorted_pixels(photo, lens).std()
    linear = lenses.undistorted_pixels(photo, lens, sharp=False).std()
    assert sharp > 0.9 * photo.std() > linear


def test_squares_are_as_small_as_the_lens_needs() -> None:
    """A picture of its own x: pixels tell where the mesh took them from."""
    counts = []
    for k in (0.002, 0.05, 0.4):
        params = (380.0, 200.0, 150.0, k)
        lens = ModelCamera(model="SIMPLE_RADIAL", width=400, height=300, params=params)
        x = np.broadcast_to(np.arange(400, dtype=np.float32) + 0.5, (300, 400))
        flat = lenses.undistorted_pixels(np.ascontiguousarray(x), lens, sharp=False)
        pinhole = lenses.undistorted_camera(lens)
        columns, rows = (np.arange(n) + 0.5 for n in (pinhole.width, pinhole.height))
        expected = lenses._places(lens, pinhole, columns, rows)[..., 0] - lenses.BORDER
        inside = (expected > 3) & (expected < 397)
        assert np.abs(flat - expected)[inside].max() < 0.02
        counts.append(len(lenses._mesh(lens)))
    assert counts == sorted(set(counts)) and counts[0] < 50


def test_masks_have_no_overshoot() -> None:
    lens = ModelCamera(model="OPENCV", width=240, height=180, params=tuple(DISTORTED["OPENCV"]))
    step = np.zeros((180, 240, 3), dtype=np.uint8)
    step[:, 120:] = 200
    made = lenses.undistorted_pixels(step, lens, sharp=False)
    assert made.max() == 200
    assert lenses.undistorted_pixels(step, lens).max() > 200


def test_files_of_others_among_the_undistorted_photos_stay(tmp_path: Path) -> None:
    folder = tmp_path / "undistorted"
    folder.mkdir()
    for name in ("holiday.png", f"{1:032x}.png"):
        (folder / name).write_bytes(b"mine")
    undistort.remove_unused(tmp_path, [])
    assert [path.name for path in folder.iterdir()] == ["holiday.png"]
