"""Gaussians where photos show no sparse point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.training.mechanisms.background_points import background_points

CELLS = 8
CAMERA = Camera(width=160, height=100, fx=120.0, fy=110.0, cx=82.0, cy=47.0)  # 8 x 5 cells


class Photos:
    """Each is of one colour on the left, and of another one on the right."""

    def __init__(
        self, mask: NDArray[np.uint8] | None = None, colour: tuple[int, int, int] = (200, 30, 0)
    ) -> None:
        self.decoded: list[int] = []
        self._mask, self._colour = mask, colour

    def __getitem__(self, index: int) -> NDArray[np.uint8]:
        self.decoded.append(index)
        photo = np.full((CAMERA.height, CAMERA.width, 3), self._colour, dtype=np.uint8)
        photo[:, : CAMERA.width // 2] = 90
        return photo if self._mask is None else np.dstack([photo, self._mask])

    def prefetch(self, indices: Sequence[int]) -> None:
        raise AssertionError("photos that need nothing would be decoded")


def pose(x: float = 0.0, y: float = 0.0, turn: float = 0.3) -> NDArray[np.float64]:
    cos, sin = np.cos(turn), np.sin(turn)
    made = np.eye(4)
    made[:3, :3] = [[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]]
    made[:3, 3] = (x, y, 0.1)
    return made


def image(points: int, world_to_camera: NDArray[np.float64] | None = None) -> PosedImage:
    return PosedImage(
        name="a.jpg",
        path=Path("a.jpg"),
        camera=CAMERA,
        world_to_camera=pose() if world_to_camera is None else world_to_camera,
        point_indices=np.arange(points),
    )


def lifted(pixels: NDArray[np.float64], depths: NDArray[np.float64]) -> NDArray[np.float64]:
    """World positions that `image` shows there."""
    rays = (pixels - (CAMERA.cx, CAMERA.cy)) / (CAMERA.fx, CAMERA.fy)
    seen = np.concatenate([rays, np.ones((len(rays), 1))], axis=1) * depths[:, None]
    return np.asarray((seen - pose()[:3, 3]) @ pose()[:3, :3])


def grid(width: int) -> NDArray[np.float64]:
    """Pixels all over the left part of the photo."""
    x, y = np.meshgrid(np.arange(2, width, 6), np.arange(2, CAMERA.height, 6))
    return np.stack((x.ravel(), y.ravel()), axis=1).astype(float)


PIXELS = grid(80)
DEPTHS = np.random.default_rng(0).uniform(2, 5, len(PIXELS))


def left_half() -> NDArray[np.float64]:
    """Points all over the left half of the photo."""
    return lifted(PIXELS, DEPTHS)


def test_cells_without_points_get_gaussians_in_their_colour() -> None:
    points = left_half()
    made, colours = background_points(points, [image(len(points))], Photos(), CELLS)
    seen = made @ pose()[:3, :3].T + pose()[:3, 3]
    pixels = seen[:, :2] / seen[:, 2:] * (CAMERA.fx, CAMERA.fy) + (CAMERA.cx, CAMERA.cy)
    # of four columns of cells on the right, the first lies beside cells with points
    x, y = np.meshgrid((110, 130, 150), (10, 30, 50, 70, 90))
    expected = np.stack((x.ravel(), y.ravel()), axis=1)
    assert sorted(map(tuple, pixels.round(6))) == sorted(map(tuple, expected.astype(float)))
    for pixel, depth in zip(pixels, seen[:, 2], strict=True):  # the farthest of the 8 next to it
        near = np.argsort(np.linalg.norm(PIXELS - pixel, axis=1))[:8]
        assert depth == pytest.approx(DEPTHS[near].max())
    assert (colours == (200, 30, 0)).all()


def test_what_a_photo_has_got_counts_for_the_next() -> None:
    points, photos = left_half(), Photos()
    one, two = image(len(points)), image(len(points), pose(x=0.2))
    alone, _ = background_points(points, [two], photos, CELLS)
    both, _ = background_points(points, [one, two, one], photos, CELLS)
    first, _ = background_points(points, [one], photos, CELLS)
    assert len(first) <= len(both) < len(first) + len(alone)


def test_photos_full_of_points_are_not_decoded() -> None:
    pixels = grid(CAMERA.width)
    points, photos = lifted(pixels, np.full(len(pixels), 3.0)), Photos()
    made, colours = background_points(points, [image(len(points))] * 2, photos, CELLS)
    assert made.shape == (0, 3) and colours.shape == (0, 3) and not photos.decoded


def test_cells_that_a_mask_ignores_get_none() -> None:
    points = left_half()
    mask = np.full((CAMERA.height, CAMERA.width), 255, dtype=np.uint8)
    mask[:, 120:] = 0
    made, _ = background_points(points, [image(len(points))], Photos(mask), CELLS)
    assert len(made) == 5  # one column of three is left


def test_black_cells_get_none() -> None:
    points = left_half()
    made, _ = background_points(points, [image(len(points))], Photos(colour=(8, 3, 0)), CELLS)
    assert len(made) == 0


def test_there_are_never_more_than_points() -> None:
    points = left_half()[:10]
    made, colours = background_points(points, [image(10)], Photos(), CELLS)
    assert len(made) == len(colours) == 10


@pytest.mark.parametrize("count", [0, 5])
def test_too_few_points_say_nothing(count: int) -> None:
    points = left_half()[:count]
    made, _ = background_points(points, [image(count)], Photos(), CELLS)
    assert len(made) == 0


def test_a_photo_whose_observations_are_not_known_takes_the_points_in_it() -> None:
    points = left_half()
    known, _ = background_points(points, [image(len(points))], Photos(), CELLS)
    unknown = replace(image(0), point_indices=np.zeros(0, dtype=np.int64))
    assert np.allclose(background_points(points, [unknown], Photos(), CELLS)[0], known)
