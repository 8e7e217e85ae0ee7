"""The surroundings of a box: a table of Gaussians with a ball on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage, SfmScene
from roigs_engine.surface import background
from roigs_engine.surface.background import _without_doubles, make_background, surroundings
from roigs_engine.surface.make import SurfaceOptions
from roigs_engine.surface.mesh import Mesh
from tests.engine.lighting.room import ball_around
from tests.poses import look_at

pytest.importorskip("skimage")
CAMERA = Camera(width=160, height=120, fx=150.0, fy=150.0, cx=80.0, cy=60.0)
BALL, MIDDLE = 0.2, np.array([0.1, 0.0, 0.25])
BOX = OrientedBox.between("ball", [-0.15, -0.25, -0.02], [0.35, 0.25, 0.5])
SPACING = 0.03
OPTIONS = SurfaceOptions(faces=20_000, texture_size=128)


def table_and_ball() -> Gaussians:
    """A table at z = 0, 2 by 2, of flat Gaussians, and a ball above it."""
    side = np.arange(-1, 1, SPACING)
    flat = np.stack([*np.meshgrid(side, side), np.zeros((len(side), len(side)))], -1).reshape(-1, 3)
    ways = ball_around(2000)
    means = np.concatenate([flat, MIDDLE + BALL * ways])
    sizes = np.full((len(means), 3), np.log(0.02))
    sizes[: len(flat), 2] = sizes[len(flat) :] = np.log(0.002)
    sizes[len(flat) :, :2] = np.log(0.015)
    halfway = ways + np.array([0, 0, 1])  # half a turn, z to the normal
    halfway /= np.maximum(np.linalg.norm(halfway, axis=1, keepdims=True), 1e-9)
    quats = np.zeros((len(means), 4))
    quats[: len(flat), 0], quats[len(flat) :, 1:] = 1, halfway
    arrays = {
        "means": means,
        "quats": quats,
        "log_scales": sizes,
        "logit_opacities": np.full(len(means), 4.0),
        "sh": np.zeros((len(means), 1, 3)),
    }
    return Gaussians.from_arrays({name: a.astype(np.float32) for name, a in arrays.items()})


def photographed() -> SfmScene:
    angles = np.arange(12) / 12 * 2 * np.pi
    eyes = [(1.3 * np.cos(a), 1.3 * np.sin(a), 0.8 + 0.3 * (k % 2)) for k, a in enumerate(angles)]
    images = tuple(
        PosedImage(
            name=f"{k:02d}.png",
            path=Path(),
            camera=CAMERA,
            world_to_camera=look_at(eye, (0, 0, 0.1)),
        )
        for k, eye in enumerate(eyes)
    )
    points = np.random.default_rng(0).uniform([-1, -1, 0], [1, 1, 0.4], (500, 3))
    far = np.array([[500.0, 0, 0]])
    points = np.concatenate([points, far])
    return SfmScene(images=images, points=points, colors=np.zeros((len(points), 3), np.uint8))


@pytest.fixture(scope="module", autouse=True)
def _small() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(background, "VOXELS", 1 << 17)
        patch.setattr(background, "NEAR_VOXELS", 1 << 17)
        yield


def made(own: dict[str, tuple[np.ndarray, np.ndarray]]) -> tuple[Mesh, float]:
    def grey(image: PosedImage) -> np.ndarray:
        return np.full((image.camera.height, image.camera.width, 3), 128, np.uint8)

    scene = photographed()
    found = make_background(table_and_ball(), scene, [BOX], own, OPTIONS, load=grey)
    assert np.abs(found.textured.picture.astype(int) - 128).max() < 10
    return found.mesh, found.voxel


@pytest.fixture(scope="module")
def whole() -> tuple[Mesh, float]:
    return made({})


def upward(mesh: Mesh) -> np.ndarray:
    """(F,) heights of faces that face up, around the box."""
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    up = mesh.crosses[:, 2] > 0.9 * np.linalg.norm(mesh.crosses, axis=1)
    ring = np.linalg.norm(middles[:, :2], axis=1)
    return middles[up & (ring > 0.35) & (ring < 0.8), 2]


def test_far_points_are_not_in_the_surroundings() -> None:
    found = surroundings(photographed())
    assert (found.half_extents < 3).all()
    assert found.contains(photographed().centres()).all()


def test_the_table_has_its_height_in_both_grids(whole: tuple[Mesh, float]) -> None:
    mesh, voxel = whole
    heights = upward(mesh)
    assert len(heights) > 30
    assert abs(np.median(heights)) < 0.15 * voxel
    assert np.quantile(np.abs(heights), 0.95) < 0.5 * voxel
    assert len(mesh.faces) <= OPTIONS.faces


def test_the_grid_is_finer_at_the_box(whole: tuple[Mesh, float]) -> None:
    mesh, voxel = whole
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    near = np.abs(np.linalg.norm(middles - MIDDLE, axis=1) - BALL) < voxel
    assert near.sum() > 200
    assert np.median(np.abs(np.linalg.norm(middles[near] - MIDDLE, axis=1) - BALL)) < 0.2 * voxel


def test_a_box_with_its_own_mesh_has_no_second_one(whole: tuple[Mesh, float]) -> None:
    ways = ball_around(20_000)
    mesh, voxel = made({"ball": (MIDDLE + BALL * ways, ways)})
    away = np.linalg.norm(mesh.vertices[mesh.faces].mean(axis=1) - MIDDLE, axis=1)
    before = np.linalg.norm(whole[0].vertices[whole[0].faces].mean(axis=1) - MIDDLE, axis=1)
    assert (np.abs(away - BALL) < 0.5 * voxel).sum() < 0.1 * (
        np.abs(before - BALL) < 0.5 * voxel
    ).sum()
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    under = (np.abs(middles[:, 2]) < 0.5 * voxel) & (np.linalg.norm(middles[:, :2], axis=1) < 0.3)
    assert under.any()  # the table in the box stays


def test_the_table_begins_where_the_plate_of_a_box_ends(whole: tuple[Mesh, float]) -> None:
    """The box's mesh has a plate of the table: no gap around it, and little is twice there."""
    low, high = np.array([-0.5, -0.6]), np.array([0.3, -0.3])
    plate = np.random.default_rng(0).uniform([*low, 0], [*high, 0], (50_000, 3))
    box = OrientedBox.between("plate", [*low, -0.1], [*high, 0.1])
    mesh, voxel = whole
    found = _without_doubles(
        mesh, [box], {"plate": (plate, np.tile([0, 0, 1.0], (50_000, 1)))}, voxel
    )
    gone = ~np.isin(_keys(mesh), _keys(found))
    corners = mesh.vertices[mesh.faces[gone]]
    assert (corners[..., :2] > low - 0.3 * voxel).all()
    assert (corners[..., :2] < high + 0.3 * voxel).all()
    assert mesh.areas[gone].sum() > 0.6 * np.prod(high - low)


def _keys(mesh: Mesh) -> np.ndarray:
    """A number for each face, by its middle."""
    return mesh.vertices[mesh.faces].mean(axis=1).round(6) @ np.array([1.0, 1e3, 1e6])
