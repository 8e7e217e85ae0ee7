"""Points and observations of a COLMAP model, odd and missing ones as well."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import Context
from roigs_engine.errors import SceneError
from roigs_engine.formats.events import Event, Message
from tests.engine.synthetic_colmap import assert_same, write_project


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
