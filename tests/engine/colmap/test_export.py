"""The files of `export`: the scene as it was loaded, with and without pycolmap."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.colmap import lenses
from roigs_engine.colmap.export import write_export
from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import Context
from roigs_engine.errors import EngineError
from roigs_engine.formats.events import Event, Message
from tests.engine.synthetic_colmap import camera, write_project


def test_files_hold_the_scene(tmp_path: Path) -> None:
    project = write_project(tmp_path / "żółw", names=["b/1.png", "a.png", "gone.png"])
    (project.folder / "images" / "gone.png").unlink()
    scene = load_colmap(project.folder, pixels=False, max_side=48)
    outputs = write_export(scene, tmp_path / "out")
    record = json.loads(Path(outputs["scene"]).read_text(encoding="utf-8"))
    assert [image["name"] for image in record["images"]] == ["a.png", "b/1.png"]
    assert record["skipped"] == {"missing on disk": {"count": 1, "first": ["gone.png"]}}
    assert record["extent"] == scene.extent()
    for image, stored in zip(scene.images, record["images"], strict=True):
        assert Path(stored["path"]).is_absolute() and Path(stored["path"]).is_file()
        assert (stored["width"], stored["height"]) == (48, 36)
        assert {k: stored[k] for k in ("fx", "fy", "cx", "cy")} == {
            k: getattr(image.camera, k) for k in ("fx", "fy", "cx", "cy")
        }
        assert np.array_equal(stored["world_to_camera"], image.world_to_camera)
        assert stored["distorted"] is False
    points, colors = np.load(outputs["points"]), np.load(outputs["colors"])
    assert points.dtype == np.float32 and colors.dtype == np.uint8
    assert np.array_equal(points, scene.points.astype(np.float32))
    assert np.array_equal(colors, scene.colors)
    observed, starts = np.load(outputs["observed"]), np.load(outputs["observed_starts"])
    for index, image in enumerate(scene.images):
        assert np.array_equal(observed[starts[index] : starts[index + 1]], image.point_indices)
    assert starts[-1] == len(observed)


OPENCV = camera("OPENCV", params=[100.0, 90.0, 45.0, 40.0, 0.05, 0.01, 0.001, 0.002])
RADIAL = camera("SIMPLE_RADIAL", params=[95.0, 47.0, 35.0, 0.08])


def test_distortion_that_was_removed_is_said(tmp_path: Path) -> None:
    write_project(tmp_path, names=["a.png", "b.png"], cameras=[OPENCV, camera()])
    images = load_colmap(tmp_path, pixels=False).images
    assert [image.distorted for image in images] == [True, False]
    assert not any(image.distorted for image in load_colmap(tmp_path).images)


def test_without_pycolmap_distortion_is_ignored_with_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing() -> None:
        raise EngineError("There is no pycolmap.")

    write_project(tmp_path, names=["a.png", "b.png"], cameras=[OPENCV, RADIAL])
    monkeypatch.setattr(lenses, "_pycolmap", missing)
    events: list[Event] = []
    first, second = load_colmap(tmp_path, pixels=False, context=Context(emit=events.append)).images
    messages = [event for event in events if isinstance(event, Message)]
    (warning,) = (message for message in messages if message.level == "warning")
    assert "pycolmap" in warning.text
    assert first.distorted and second.distorted
    a, b = first.camera, second.camera
    assert (a.fx, a.fy, a.cx, a.cy) == (100.0, 90.0, 45.0, 40.0)
    assert (b.fx, b.fy, b.cx, b.cy) == (95.0, 95.0, 47.0, 35.0)
    assert (a.width, a.height) == (OPENCV.width, OPENCV.height)
    with pytest.raises(EngineError, match="pycolmap"):
        load_colmap(tmp_path)
