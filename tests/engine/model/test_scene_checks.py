"""Cameras and points that lie far away by mistake."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roigs_engine.model.scene import PosedImage, SfmScene
from roigs_engine.model.scene_checks import STRAY, without_outliers
from tests.engine.synthetic_scene import make_scene
from tests.poses import look_at


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"), views=12)


def with_camera_at(scene: SfmScene, offset: object, row: int = 3) -> SfmScene:
    """The scene with one camera moved by `offset` (3,), its rotation kept."""
    images = list(scene.images)
    pose = images[row].world_to_camera.copy()
    pose[:3, 3] -= pose[:3, :3] @ np.asarray(offset, float)
    images[row] = replace(images[row], world_to_camera=pose)
    return replace(scene, images=tuple(images))


@pytest.mark.parametrize("offset", [(300, 0, 0), (0, -30, 0), (0, 0, 1e7), (1e12, 1e12, 0)])
def test_a_stray_camera_is_left_out(scene: SfmScene, offset: tuple[float, ...]) -> None:
    cleaned = without_outliers(with_camera_at(scene, offset))
    assert cleaned.skipped == {STRAY: (scene.images[3].name,)}
    assert len(cleaned.images) == 11
    assert cleaned.extent() == pytest.approx(scene.extent(), rel=0.2)


def test_a_stray_camera_straight_behind_its_place(scene: SfmScene) -> None:
    """All its points project into its photo, but to one spot."""
    behind = -300 * scene.images[3].forward
    assert STRAY in without_outliers(with_camera_at(scene, behind)).skipped


def test_sound_scenes_keep_everything(scene: SfmScene) -> None:
    assert without_outliers(scene) is scene
    few = replace(scene, images=scene.images[:2])
    assert without_outliers(few) is few


def test_a_view_from_far_away_is_kept(scene: SfmScene) -> None:
    """A drone with a long lens: far from the others, its points all over its photo."""
    image = scene.images[3]
    eye = np.array([0.0, -120.0, 60.0])
    camera = replace(image.camera, fx=image.camera.fx * 60, fy=image.camera.fy * 60)
    drone = replace(image, world_to_camera=look_at(eye, np.zeros(3)), camera=camera)
    images = tuple(drone if i is image else i for i in scene.images)
    kept = without_outliers(replace(scene, images=images))
    assert len(kept.images) == 12 and not kept.skipped
    assert kept.extent() < 3 * scene.extent()  # it does not set the scale of training


def test_without_tracks_distance_decides(scene: SfmScene) -> None:
    def untracked(image: PosedImage) -> PosedImage:
        return replace(image, point_indices=image.point_indices[:0])

    far = with_camera_at(scene, (300, 0, 0))
    bare = replace(far, images=tuple(map(untracked, far.images)), has_tracks=False)
    assert STRAY in without_outliers(bare).skipped


def test_cameras_at_one_place(scene: SfmScene) -> None:
    """A panorama: their distances are rounding errors, of which none is stray."""
    rng = np.random.default_rng(0)
    images = []
    for image in scene.images:
        pose = image.world_to_camera.copy()
        pose[:3, 3] = rng.normal(size=3) * 1e-10
        images.append(replace(image, world_to_camera=pose))
    images[0].world_to_camera[:3, 3] *= 1e3
    panorama = without_outliers(replace(scene, images=tuple(images)))
    assert len(panorama.images) == 12
    assert 0.1 < panorama.extent() < 10  # the distance of the points


def test_far_points_are_left_out_and_tracks_follow(scene: SfmScene) -> None:
    points = scene.points.copy()
    points[5] = 1e6
    cleaned = without_outliers(replace(scene, points=points))
    assert cleaned.stray_points == 1 and len(cleaned.points) == len(points) - 1
    for before, after in zip(scene.images, cleaned.images, strict=True):
        wanted = scene.points[[row for row in before.point_indices if row != 5]]
        np.testing.assert_array_equal(cleaned.points[after.point_indices], wanted)


@pytest.mark.parametrize("baseline", [0.3, 0.01, 1e-3])
def test_a_panorama_keeps_its_points(scene: SfmScene, baseline: float) -> None:
    """Cameras close together in a wide place: far from them is not far in it."""
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(len(scene.points), 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    points = rays * rng.uniform(2, 60, (len(rays), 1))
    images = []
    for k, image in enumerate(scene.images):
        angle = 2 * np.pi * k / len(scene.images)
        eye = baseline * np.array([np.cos(angle), np.sin(angle), 0])
        images.append(replace(image, world_to_camera=look_at(eye, 10 * eye)))
    panorama = replace(scene, images=tuple(images), points=points)
    assert without_outliers(panorama).stray_points == 0
