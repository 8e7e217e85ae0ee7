"""Cameras and scenes as values."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from roigs_engine.model.scene import Camera, PosedImage, SfmScene

CAMERA = Camera(width=100, height=50, fx=80.0, fy=90.0, cx=51.0, cy=24.0)


def posed(name: str, centre: list[float], turn: float = 0.0) -> PosedImage:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0, turn, 0]).as_matrix()
    pose[:3, 3] = -pose[:3, :3] @ np.array(centre)
    return PosedImage(
        name=name,
        path=Path(name),
        camera=CAMERA,
        world_to_camera=pose,
        point_indices=np.zeros(0, dtype=np.int64),
    )


def scene_of(*images: PosedImage) -> SfmScene:
    return SfmScene(images=images, points=np.zeros((0, 3)), colors=np.zeros((0, 3), np.uint8))


def test_intrinsic_matrix_projects_as_the_fields_say() -> None:
    pixel = CAMERA.matrix() @ [0.5, -0.25, 2.0]
    assert np.allclose(pixel[:2] / pixel[2], [80 * 0.25 + 51, 90 * -0.125 + 24])


def test_resized_camera_sees_the_same_rays() -> None:
    small = CAMERA.resized(25, 10)
    assert (small.width, small.height) == (25, 10)
    ray = np.array([0.3, -0.2, 1.0])
    big, little = CAMERA.matrix() @ ray, small.matrix() @ ray
    assert np.allclose(big[:2] / [100, 50], little[:2] / [25, 10])


def test_a_scaled_photo_sees_the_same_rays() -> None:
    image = posed("a", [1.0, 2.0, 3.0])
    assert image.scaled(1.0) is image
    assert (image.pixel_size, image.whole_size) == (1.0, None)
    half = image.scaled(0.5)
    assert half.camera == CAMERA.resized(50, 25)
    assert (half.pixel_size, half.whole_size) == (2.0, (100, 50))
    assert half.scaled(0.4).whole_size == (100, 50)
    assert half.scaled(0.4).pixel_size == 5.0


def test_centre_and_forward() -> None:
    image = posed("a", [1.0, 2.0, 3.0], turn=0.4)
    assert np.allclose(image.centre, [1, 2, 3])
    ahead = image.centre + 2 * image.forward
    in_camera = image.world_to_camera @ [*ahead, 1]
    assert np.allclose(in_camera[:3], [0, 0, 2])


def test_select_and_without_keep_the_scene_s_order() -> None:
    scene = scene_of(*(posed(name, [0, 0, 0]) for name in "abcd"))
    assert [i.name for i in scene.select(["d", "b", "none"]).images] == ["b", "d"]
    assert [i.name for i in scene.without({"a", "c"}).images] == ["b", "d"]
    assert len(scene.images) == 4
    assert scene.image("c").name == "c"
    with pytest.raises(KeyError):
        scene.image("e")


def test_extent_is_that_of_3dgs() -> None:
    scene = scene_of(posed("a", [0, 0, 0]), posed("b", [4, 0, 0]))
    assert scene.extent() == pytest.approx(2.2)
    assert scene_of().extent() == 0.0
    points = np.array([[1.0, 0, 3], [1.0, 4, 0], [6.0, 0, 0]])
    one_place = replace(scene_of(posed("a", [1, 0, 0])), points=points)
    assert one_place.extent() == pytest.approx(4)  # else nothing could move, and all be pruned
    assert scene_of().centres().shape == (0, 3)
