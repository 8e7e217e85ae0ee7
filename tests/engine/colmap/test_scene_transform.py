"""Export of a scene as it was placed in Blender."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.cli import main
from roigs_engine.colmap.export import transformed
from roigs_engine.colmap.project import load_colmap
from roigs_engine.formats.scene_transform import FILE, SceneTransform, document
from tests.engine.synthetic_colmap import write_project

TURN = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0.0]])
MATRIX = np.eye(4)
MATRIX[:3, :3], MATRIX[:3, 3] = 2.5 * TURN, (10, -3, 0.5)


@pytest.fixture
def garden(tmp_path: Path) -> Path:
    return write_project(tmp_path / "garden", names=["a.png", "b.png", "c.png"]).folder


def place(garden: Path, shift: float = 0.0) -> None:
    images = load_colmap(garden, pixels=False).images
    cameras = {image.name: image.centre + shift for image in images}
    (garden / FILE).write_text(document(SceneTransform(matrix=MATRIX, cameras=cameras), []))


def exported(garden: Path, out: Path, *options: str) -> tuple[dict, np.ndarray]:
    assert main(["export", str(garden), "--out", str(out), *options]) == 0
    record = json.loads((out / "scene.json").read_text(encoding="utf-8"))
    return record, np.load(out / "points.npy")


def test_photos_see_the_same_after_it(garden: Path) -> None:
    scene = load_colmap(garden, pixels=False)
    moved = transformed(scene, MATRIX)
    for before, after in zip(scene.images, moved.images, strict=True):
        a, b = (
            s.points @ i.world_to_camera[:3, :3].T + i.world_to_camera[:3, 3]
            for s, i in ((scene, before), (moved, after))
        )
        np.testing.assert_allclose(b, 2.5 * a, atol=1e-9)
        centre = MATRIX[:3, :3] @ before.centre + MATRIX[:3, 3]
        np.testing.assert_allclose(after.centre, centre, atol=1e-9)
        np.testing.assert_allclose(
            after.world_to_camera[:3, :3] @ after.world_to_camera[:3, :3].T, np.eye(3), atol=1e-9
        )


def test_export_is_in_the_colmap_frame_unless_asked(garden: Path, tmp_path: Path) -> None:
    record, before = exported(garden, tmp_path / "a")
    assert record["placement"] is None and record["frame"] == "colmap"
    place(garden)
    record, points = exported(garden / "sparse" / "0", tmp_path / "b")
    np.testing.assert_array_equal(points, before)
    np.testing.assert_allclose(record["placement"], MATRIX)
    assert record["frame"] == "colmap"
    record, points = exported(garden, tmp_path / "c", "--placed")
    np.testing.assert_allclose(points, before @ MATRIX[:3, :3].T + MATRIX[:3, 3], atol=1e-4)
    assert record["frame"] == "placed"
    low, high = record["bounds"]
    assert (np.array(low) > points.min(axis=0) - 1e-3).all() and np.less(low, high).all()


def test_a_placement_that_cannot_be_used(
    garden: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(garden), "--out", str(tmp_path / "a"), "--placed"]) == 2
    assert "Place the scene in Blender first" in capsys.readouterr().err
    for make, text in (
        (lambda: place(garden, shift=5.0), "not of this model"),
        (lambda: (garden / FILE).write_text("{"), "not JSON"),
    ):
        make()
        record, _ = exported(garden, tmp_path / "b")
        assert record["placement"] is None
        said = capsys.readouterr()
        assert text in said.out + said.err
        assert main(["export", str(garden), "--out", str(tmp_path / "c"), "--placed"]) == 2
        assert text in capsys.readouterr().err
