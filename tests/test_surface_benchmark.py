"""`benchmarks.surface` on shapes whose distances, normals and pictures are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.surface import distances, pictures
from benchmarks.surface.distances import Samples
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage

CAMERA = Camera(width=80, height=60, fx=70.0, fy=70.0, cx=40.0, cy=30.0)
FRONT = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]])
"""Looks along z, from 2 in front of the origin."""


def globe(radius: float, rows: int = 24) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces of a sphere, its normals outwards."""
    around, down = np.meshgrid(np.linspace(0, 2 * np.pi, 2 * rows), np.linspace(0, np.pi, rows))
    xyz = np.stack([np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)], -1)
    i, j = np.mgrid[0 : rows - 1, 0 : 2 * rows - 1]
    a = i * 2 * rows + j
    quads = np.stack([a, a + 2 * rows, a + 2 * rows + 1, a + 1], -1).reshape(-1, 4)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return radius * xyz.reshape(-1, 3), faces


def sphere(radius: float, rows: int = 24) -> NDArray[np.float32]:
    vertices, faces = globe(radius, rows)
    return vertices[faces].astype(np.float32)


def photo(pose: NDArray[np.float64] = FRONT) -> PosedImage:
    return PosedImage(name="a.jpg", path=Path("a.jpg"), camera=CAMERA, world_to_camera=pose)


@pytest.fixture(autouse=True)
def _fewer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(distances, "SAMPLES", 20_000)


def test_a_surface_that_is_true_has_f_1_and_one_too_large_by_3_mm_none_at_2() -> None:
    true = sphere(0.1)
    samples = distances.sampled(true, 4000)
    truth = samples.rows(samples.points[:, 2] > -0.09)
    same = distances.compare(true, true, truth, 1.0)
    assert same.f == pytest.approx((1, 1, 1), abs=0.001)
    assert same.normals < 3
    assert same.off[1] < 1e-5
    larger = distances.compare(sphere(0.103), true, truth, 1.0)
    assert larger.f[1] < 0.01 and larger.f[2] > 0.99
    assert larger.off[0] == pytest.approx(0.003, abs=0.0003)
    inside_out = distances.compare(true[:, ::-1], true, truth, 1.0)
    assert inside_out.normals > 175


def test_the_nearest_point_of_a_triangle_is_inside_on_an_edge_or_a_corner() -> None:
    triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    points = np.array([[0.2, 0.2, 5], [0.5, -1, 1], [3, -1, 0], [1, 1, 0]])
    found = distances.closest(points, np.repeat(triangle[None], 4, axis=0))
    np.testing.assert_allclose(found, [[0.2, 0.2, 0], [0.5, 0, 0], [1, 0, 0], [0.5, 0.5, 0]])


def test_only_the_side_that_photos_look_at_is_seen_and_nothing_behind_a_wall(
    tmp_path: Path,
) -> None:
    true, far = sphere(0.2, 40), np.full((1, 3, 3), 9.0, np.float32)
    truth, seen = distances.seen_truth(true, far, [photo(), photo()], tmp_path)
    assert truth.points[:, 2].max() < 0.05 and 0.3 < seen < 0.5
    assert (truth.normals[:, 2] < 0).all()  # towards the photos
    again, share = distances.seen_truth(true, far, [photo(), photo()], tmp_path)
    np.testing.assert_array_equal(again.points, truth.points)
    assert share == seen and len(list(tmp_path.iterdir())) == 1
    assert distances.seen_truth(true, far, [photo()], tmp_path)[1] == 0
    wall = np.array([[[-5, -5, -1], [5, -5, -1], [0, 9, -1]]], np.float32)
    samples = Samples(points=truth.points, normals=truth.normals, faces=truth.faces)
    assert not distances.views_of(samples, np.concatenate([true, wall]), [photo()])[0].any()


def test_a_layer_behind_a_slanted_one_is_not_seen() -> None:
    """5 mm behind it, where a pixel is 14 mm large."""
    front = np.array([[[-1, -1, -1], [1, -1, -1], [0, 1, 1]]], np.float32)
    behind = front + np.float32(0.005) * np.array([0, -1, 1], np.float32) / np.sqrt(2)
    both = np.concatenate([front, behind]).astype(np.float32)
    for sheet, wanted in ((front, True), (behind, False)):
        samples = distances.sampled(sheet, 2000)
        samples = samples.rows(np.abs(samples.points - (0, -0.3, -0.3)).max(axis=1) < 0.2)
        views = distances.views_of(samples, both, [photo()])[0]
        assert len(views) > 20 and (views > 0).all() == wanted and views.any() == wanted


def test_a_mesh_is_moved_back_onto_the_truth() -> None:
    true = sphere(0.1) * np.float32([1, 0.7, 0.5])
    moved = true + np.float32([0.002, -0.001, 0.0015])
    assert np.abs(distances.aligned(moved, true) - true).max() < 3e-4


def test_a_drawn_mesh_shows_its_texture_and_hides_what_is_behind() -> None:
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    texture = np.zeros((4, 4, 3))
    texture[:, 2:] = 1, 0.5, 0
    behind = pictures.Mesh(
        vertices=np.concatenate([corners, 3 * corners + (0, 0, 1)]),
        faces=np.concatenate([faces, faces + 4]),
        uv=np.concatenate([(corners[:, :2] + 1) / 2, np.zeros((4, 2))]),
        texture=texture,
        colours=np.zeros((8, 3)),
        components=2,
    )
    colours, alpha = pictures.drawn(behind, CAMERA, FRONT)
    assert (alpha == 1).all()
    np.testing.assert_allclose(colours[30, 60], (1, 0.5, 0))
    np.testing.assert_allclose(colours[30, 20], 0)
    one = pictures.Mesh(**{**vars(behind), "faces": faces})
    alpha = pictures.drawn(one, CAMERA, FRONT)[1]
    assert alpha.sum() == pytest.approx(35 * 2 * 30 * 2, rel=0.01)


def test_mesh_files_are_read_with_y_or_z_up(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    vertices, faces = globe(0.1)
    vertices += (0, 0, 0.5)
    box = OrientedBox.between("b", np.array([-1, -1, 0.3]), np.array([1.0, 1, 1]))
    for name, points in (("z.ply", vertices), ("y.glb", vertices @ pictures.Y_UP)):
        trimesh.Trimesh(points, faces, process=False).export(tmp_path / name)
        mesh = pictures.load_mesh(tmp_path / name, box)
        np.testing.assert_allclose(mesh.vertices.mean(axis=0), (0, 0, 0.5), atol=0.01)
        assert mesh.components == 1
