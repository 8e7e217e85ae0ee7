"""Boxes: what is inside, the silhouette against brute force, files and command-line text."""

from __future__ import annotations

import json
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from roigs_engine.errors import RoiError
from roigs_engine.model.ownership import nearest_owner
from roigs_engine.model.roi import OrientedBox, load_rois, parse_roi, roi_from_dict
from roigs_engine.model.scene import Camera

CAMERA = Camera(width=80, height=60, fx=70.0, fy=75.0, cx=41.0, cy=28.5)
SEEDS = st.integers(0, 2**32 - 1)


def random_box(rng: np.random.Generator, name: str = "box") -> OrientedBox:
    transform = np.eye(4)
    transform[:3, :3] = Rotation.random(random_state=rng.integers(2**31)).as_matrix()
    transform[:3, 3] = rng.normal(size=3)
    return OrientedBox(name=name, world_to_box=transform, half_extents=rng.uniform(0.2, 2.0, 3))


def random_pose(rng: np.random.Generator, distance: float) -> np.ndarray:
    """A camera anywhere about the origin, looking anywhere."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=rng.integers(2**31)).as_matrix()
    pose[:3, 3] = rng.normal(size=3) * distance
    return pose


def surface_points(box: OrientedBox, side: int = 60) -> np.ndarray:
    """(M, 3) world positions: a dense grid on the six faces."""
    u, v = (g.ravel() for g in np.meshgrid(*[np.linspace(-1, 1, side)] * 2))
    faces = [
        np.insert(np.stack([u, v], axis=1), axis, sign, axis=1)
        for axis in range(3)
        for sign in (-1.0, 1.0)
    ]
    local = np.concatenate(faces) * box.half_extents
    return (local - box.world_to_box[:3, 3]) @ box.world_to_box[:3, :3]


def ray_hits(box: OrientedBox, camera: Camera, pose: np.ndarray) -> np.ndarray:
    """(H, W) whether the ray through each pixel's centre meets the box in front of the camera."""
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    directions = np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], axis=-1)
    turn = box.world_to_box[:3, :3] @ pose[:3, :3].T
    eye = turn @ -pose[:3, 3] + box.world_to_box[:3, 3]
    directions = directions @ turn.T
    with np.errstate(divide="ignore"):
        a = (-box.half_extents - eye) / directions
        b = (box.half_extents - eye) / directions
    enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
    return (enter <= leave) & (leave > 0)


def disagreement(box: OrientedBox, pose: np.ndarray) -> float:
    """Share of the image where the silhouette and the rays differ."""
    return float((box.silhouette(CAMERA, pose) != ray_hits(box, CAMERA, pose)).mean())


@given(SEEDS)
def test_contains_follows_the_rotation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = random_box(rng)
    local = rng.uniform(-2, 2, (50, 3))
    world = (local * box.half_extents - box.world_to_box[:3, 3]) @ box.world_to_box[:3, :3]
    expected = (np.abs(local) < 1).all(axis=1)
    assert (box.contains(world) == expected).all()
    assert np.allclose(box.to_box(world), local)
    assert np.allclose(box.to_box(box.centre[None]), 0)


@given(SEEDS)
def test_the_distance_is_that_of_the_nearest_point_of_the_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box = random_box(rng)
    local = rng.uniform(-3, 3, (50, 3))

    def placed(local: np.ndarray) -> np.ndarray:
        return (local * box.half_extents - box.world_to_box[:3, 3]) @ box.world_to_box[:3, :3]

    points, nearest = placed(local), placed(np.clip(local, -1, 1))
    distance = box.distance(points)
    assert np.allclose(distance, np.linalg.norm(points - nearest, axis=1), atol=1e-9)
    assert ((distance == 0) == box.contains(points)).all()
    for inside in placed(rng.uniform(-1, 1, (20, 3))):
        assert (np.linalg.norm(points - inside, axis=1) >= distance - 1e-9).all()


@given(SEEDS)
def test_moving_box_and_points_together_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box, motion = random_box(rng), random_pose(rng, 5.0)
    moved = OrientedBox(
        name="box",
        world_to_box=box.world_to_box @ np.linalg.inv(motion),
        half_extents=box.half_extents,
    )
    points = rng.normal(size=(50, 3)) * 2
    away = points @ motion[:3, :3].T + motion[:3, 3]
    assert np.allclose(box.to_box(points), moved.to_box(away))
    assert np.allclose(box.corners() @ motion[:3, :3].T + motion[:3, 3], moved.corners())


@settings(max_examples=60)
@given(SEEDS, st.sampled_from([0.5, 1.5, 4.0, 12.0]))
def test_silhouette_equals_the_rays_that_meet_the_box(seed: int, distance: float) -> None:
    rng = np.random.default_rng(seed)
    box, pose = random_box(rng), random_pose(rng, distance)
    if box.camera_inside(pose):
        assert box.silhouette(CAMERA, pose).all()
        return
    # Rays that meet the box only nearer than the near plane, or on its very edge, may differ.
    assert disagreement(box, pose) < 0.005


@settings(max_examples=40)
@given(SEEDS)
def test_silhouette_holds_every_projected_point_of_the_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    box, pose = random_box(rng), random_pose(rng, 4.0)
    points = surface_points(box) @ pose[:3, :3].T + pose[:3, 3]
    points = points[points[:, 2] > 0.05]
    x = points[:, 0] / points[:, 2] * CAMERA.fx + CAMERA.cx
    y = points[:, 1] / points[:, 2] * CAMERA.fy + CAMERA.cy
    seen = (x >= 1) & (x < CAMERA.width - 1) & (y >= 1) & (y < CAMERA.height - 1)
    mask = box.silhouette(CAMERA, pose)
    padded = np.pad(mask, 1)
    # The pixel of a point on the outline has its centre outside by less than a pixel.
    near = np.logical_or.reduce(
        [padded[i : i + CAMERA.height, j : j + CAMERA.width] for i in range(3) for j in range(3)]
    )
    area = int(mask.sum())
    if area > 50:  # a sliver between pixel centres has points but no pixels
        assert near[y[seen].astype(int), x[seen].astype(int)].mean() > 0.999


def test_corners_behind_the_camera_are_clipped() -> None:
    # A long corridor that reaches from behind the camera, beside it, to far in front.
    box = OrientedBox.between("corridor", [0.5, -1, -20], [3, 1, 30])
    pose = np.eye(4)
    assert not box.camera_inside(pose)
    mask = box.silhouette(CAMERA, pose)
    assert disagreement(box, pose) < 0.005
    assert mask[:, -1].any()
    assert not mask[:, 0].any()


def test_box_behind_the_camera_has_no_silhouette() -> None:
    box = OrientedBox.between("behind", [-1, -1, -5], [1, 1, -3])
    assert not box.silhouette(CAMERA, np.eye(4)).any()
    assert box.silhouette_polygon(CAMERA, np.eye(4)) is None
    assert box.projected_area(CAMERA, np.eye(4)) == 0


def test_camera_inside_sees_the_whole_image() -> None:
    box = OrientedBox.between("room", [-1, -1, -1], [1, 1, 1])
    assert box.camera_inside(np.eye(4))
    assert box.projected_area(CAMERA, np.eye(4)) == 1


def test_silhouette_goes_by_pixel_centres() -> None:
    camera = Camera(width=8, height=6, fx=10.0, fy=10.0, cx=0.0, cy=0.0)
    # Its front face, at depth 10, spans pixels 2.4..5.6 by 1.6..3.4; the back face lies within.
    box = OrientedBox.between("flat", [2.4, 1.6, 10], [5.6, 3.4, 10.0001])
    # Centres inside: x at 2.5, 3.5, 4.5, 5.5 and y at 2.5 alone.
    mask = box.silhouette(camera, np.eye(4))
    assert mask.sum() == 4
    assert mask[2, 2:6].all()


@given(SEEDS)
def test_owner_is_a_box_that_holds_the_point_and_the_nearest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boxes = [random_box(rng, str(k)) for k in range(3)]
    points = rng.normal(size=(200, 3)) * 1.5
    owner = nearest_owner(points, boxes)
    inside = np.stack([box.contains(points) for box in boxes])
    distance = np.stack([np.linalg.norm(box.to_box(points), axis=1) for box in boxes])
    distance[~inside] = np.inf
    assert ((owner >= 0) == inside.any(axis=0)).all()
    held = owner >= 0
    assert (owner[held] == distance[:, held].argmin(axis=0)).all()


def test_box_from_the_command_line() -> None:
    box = parse_roi("vase=0,1,2,3,5,7")
    assert box.name == "vase"
    assert np.allclose(box.centre, [1.5, 3, 4.5])
    assert np.allclose(box.half_extents, [1.5, 2, 2.5])


@pytest.mark.parametrize(
    "text",
    ["", "vase", "vase=", "=0,0,0,1,1,1", "vase=0,0,0,1,1", "vase=0,0,0,1,1,x", "vase=0,0,0,1,1,0"],
)
def test_malformed_command_line_box_is_one_line(text: str) -> None:
    with pytest.raises(RoiError) as caught:
        parse_roi(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "not json",
        "{}",
        "[]",
        "3",
        '{"rois": [3]}',
        '{"rois": [{"name": "a"}]}',
        '{"rois": [{"min": [0,0,0], "max": [1,1,1]}]}',
        '{"rois": [{"name": "a", "min": [0,0], "max": [1,1]}]}',
        '{"rois": [{"name": "a", "min": [0,0,0], "max": [1,1,NaN]}]}',
        '{"rois": [{"name": "a", "min": [0,0,0], "max": [1,1,1]},'
        ' {"name": "a", "min": [0,0,0], "max": [1,1,1]}]}',
        "[" * 200_000,
        '{"rois": [{"name": "a", "min": [0,0,0], "max": [1,1,1' + "0" * 400 + "]}]}",
        '{"rois": [{"name": "a", "min": [-1e308,0,0], "max": [1e308,1,1]}]}',
        '{"rois": [{"name": "a", "min": [0,0,0], "max": [1,1,1e16]}]}',
    ],
)
def test_malformed_file_is_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "rois.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RoiError) as caught:
        load_rois(path)
    assert "\n" not in str(caught.value)


def test_a_silhouette_takes_little_more_than_its_pixels() -> None:
    camera = Camera(width=6000, height=4000, fx=5000.0, fy=5000.0, cx=3000.0, cy=2000.0)
    pose = np.eye(4)
    pose[2, 3] = 4.0
    box = OrientedBox.between("box", [-1, -1, -1], [1, 1, 1])
    tracemalloc.start()
    mask = box.silhouette(camera, pose)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert mask.mean() > 0.4
    assert peak < mask.nbytes + (64 << 20)


def test_gaussians_at_no_place_are_in_no_box() -> None:
    points = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [1e308, -1e308, 0]])
    box = random_box(np.random.default_rng(0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        owner = nearest_owner(np.concatenate([points, box.centre[None]]), [box])
    assert owner.tolist() == [-1, -1, -1, 0]


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(RoiError):
        load_rois(tmp_path / "none.json")


def test_scaled_transform_is_refused() -> None:
    with pytest.raises(RoiError, match="rotation"):
        roi_from_dict(
            {"name": "a", "world_to_box": (2 * np.eye(4)).tolist(), "half_extents": [1, 1, 1]}
        )


def test_files_keep_boxes(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    boxes = [random_box(rng, name) for name in ("vase", "stół z blatem")]
    path = tmp_path / "rois.json"
    path.write_text(json.dumps({"rois": [box.to_dict() for box in boxes]}), encoding="utf-8")
    for box, back in zip(boxes, load_rois(path), strict=True):
        assert back.name == box.name
        assert np.array_equal(back.world_to_box, box.world_to_box)
        assert np.array_equal(back.half_extents, box.half_extents)
