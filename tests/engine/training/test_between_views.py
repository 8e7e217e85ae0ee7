"""What fills a view between the photos goes if no photo shows it, and what is real stays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from roigs_engine.context import Context
from roigs_engine.errors import Stopped
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import PosedImage
from roigs_engine.training.between_views import MOST_VIEWS, fills_only_between, views_between
from tests.engine.synthetic_scene import CAMERA
from tests.poses import look_at

DISTANCE = 4.0
OBJECT = np.random.default_rng(0).normal(scale=0.1, size=(50, 3))  # the scene's points
NO_POINTS = np.zeros((0, 3))


def photo(name: str, eye: np.ndarray, target: np.ndarray | None = None) -> PosedImage:
    return PosedImage(
        name=name,
        path=Path(),
        camera=CAMERA,
        world_to_camera=look_at(eye, np.zeros(3) if target is None else target),
        point_indices=np.zeros(0, dtype=np.int64),
    )


def ring(count: int, whole: int | None = None) -> list[PosedImage]:
    """`count` photos of a ring of `whole` around the origin."""
    return [photo(f"{k}.png", at(k / (whole or count))) for k in range(count)]


def at(share: float, distance: float = DISTANCE) -> np.ndarray:
    """A place on the ring."""
    angle = 2 * np.pi * share
    return distance * np.array([np.cos(angle), np.sin(angle), 0.0])


def gaussians(*sized: tuple[np.ndarray, float]) -> Gaussians:
    """Opaque balls, each (place, standard deviation)."""
    count = len(sized)
    arrays = {
        "means": np.array([place for place, _ in sized]).reshape(count, 3),
        "quats": np.tile([1.0, 0, 0, 0], (count, 1)),
        "log_scales": np.log([size for _, size in sized])[:, None].repeat(3, axis=1),
        "logit_opacities": np.full(count, 3.0),
        "sh": np.zeros((count, 16, 3)),
    }
    return Gaussians.from_arrays({name: a.astype(np.float32) for name, a in arrays.items()})


def fog(model: Gaussians, images: list[PosedImage]) -> list[bool]:
    return fills_only_between(model, images, views_between(images, OBJECT)).tolist()


def test_fog_before_a_view_between_two_photos_goes_and_the_object_stays() -> None:
    images = ring(10)
    hidden = at(0.05, 0.9 * DISTANCE), 0.05  # between the first two, beside both pictures
    model = gaussians((np.zeros(3), 0.3), hidden)
    assert not sees(images[0], hidden[0]) and not sees(images[1], hidden[0])
    assert fog(model, images) == [False, True]


def sees(image: PosedImage, point: np.ndarray) -> bool:
    """Whether a point is inside the photo's frame."""
    x, y, z = image.world_to_camera[:3, :3] @ point + image.world_to_camera[:3, 3]
    u, v = CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy
    return bool(z > 0 and 0 <= u < CAMERA.width and 0 <= v < CAMERA.height)


def test_what_a_photo_shows_as_large_stays() -> None:
    images = ring(10)
    before_a_photo = at(0.0, 0.95 * DISTANCE), 0.05
    assert fog(gaussians(before_a_photo), images) == [False]


def test_a_view_close_to_the_scene_is_not_used() -> None:
    """Two photos with a pillar between them: a camera in the pillar would see nothing else."""
    target = np.array([0.0, 8.0, 0.0])
    images = [photo("a", np.array([-2.0, 0, 0]), target), photo("b", np.array([2.0, 0, 0]), target)]
    pillar = OBJECT * 0.5  # at the origin, half way
    far_away = OBJECT + target
    used, less = (
        views_between(images, points) for points in (far_away, np.concatenate([pillar, far_away]))
    )
    assert len(used) == 3 + 8
    assert len(less) < len(used)


def test_fog_beside_a_photo_far_from_the_others_goes() -> None:
    """Between photos there is no view of it: it hangs above a photo."""
    images = ring(10)
    above = images[0].centre - 0.7 * images[0].world_to_camera[1, :3]
    hidden = above + 0.1 * (np.zeros(3) - above), 0.03
    assert not any(sees(image, hidden[0]) for image in images[:2])
    assert fog(gaussians((np.zeros(3), 0.3), hidden), images) == [False, True]


def test_a_photo_alone_has_no_views_and_opposite_ones_none_between_them() -> None:
    assert views_between(ring(1), OBJECT) == ()
    assert len(views_between(ring(2), OBJECT)) == 8  # beside them only


def test_views_of_many_photos_are_limited_and_of_few_are_three_per_pair() -> None:
    assert len(views_between(ring(400), OBJECT)) == 2 * MOST_VIEWS
    assert len(views_between(ring(3, 24), OBJECT)) == 9 + 12


def test_without_points_all_views_are_used() -> None:
    assert len(views_between(ring(3, 24), NO_POINTS)) == 9 + 12


def test_the_unit_of_the_world_does_not_matter() -> None:
    model = gaussians((np.zeros(3), 0.3), (at(0.05, 0.9 * DISTANCE), 0.05))
    scale = 1024.0
    scaled = {"means": model.means * scale, "log_scales": model.log_scales + np.log(scale)}
    images = [photo(image.name, image.centre * scale) for image in ring(10)]
    views = views_between(images, OBJECT * scale)
    assert len(views) == len(views_between(ring(10), OBJECT))
    larger = Gaussians(**model.tensors() | scaled)
    assert fills_only_between(larger, images, views).tolist() == [False, True]


def test_it_can_be_stopped() -> None:
    stopping = Context(should_stop=lambda: True)
    images = ring(10)
    with pytest.raises(Stopped):
        fills_only_between(
            gaussians((np.zeros(3), 0.3)), images, views_between(images, OBJECT), stopping
        )


def test_nothing_changes_for_a_model_without_gaussians() -> None:
    images = ring(10)
    none = fills_only_between(gaussians(), images, views_between(images, OBJECT))
    assert none.shape == (0,) and none.dtype == torch.bool
