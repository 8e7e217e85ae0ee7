"""Panoramic cameras in Blender's own renders, against pinhole pictures from the same point."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.pictures import linear, load_rgba, psnr, srgb
from tests.addon.scenes import emitting_plane, through_a_photo

pytestmark = pytest.mark.exact_look


@pytest.fixture
def shot(blender: ModuleType, run, engine, tmp_path: Path):
    """A scene seen through a photo's camera, a wall that covers a part, and a function: renders."""
    from mathutils import Vector

    bpy, (scene, _) = blender, run
    render = through_a_photo(bpy, scene)
    camera = scene.camera.matrix_world
    wall = emitting_plane(bpy, camera, 1.0, (0.1, 0.5, 0.1))

    def f12(depth: float) -> np.ndarray:
        """(H, W, 4) in linear light, multiplied by alpha; the wall is so far, and as large."""
        scene.cycles.samples = 4
        wall.location = camera @ Vector((-0.3 * depth, 0.1 * depth, -depth))
        wall.scale = [0.3 * depth] * 3
        render.filepath = str(tmp_path / "f12.png")
        bpy.ops.render.render(write_still=True)
        picture = load_rgba(Path(render.filepath))
        return np.concatenate([linear(picture[..., :3]) * picture[..., 3:], picture[..., 3:]], -1)

    return scene, f12


def looked_up(panorama: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Between the pixels of a picture, at places in pixels."""
    x, y = x - 0.5, y - 0.5
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    a, b = (x - column)[..., None], (y - row)[..., None]
    upper = panorama[row, column] * (1 - a) + panorama[row, column + 1] * a
    lower = panorama[row + 1, column] * (1 - a) + panorama[row + 1, column + 1] * a
    return upper * (1 - b) + lower * b


def smaller(picture: np.ndarray) -> np.ndarray:
    """With means of 3 x 3 pixels."""
    height, width, channels = picture.shape
    return picture.reshape(height // 3, 3, width // 3, 3, channels).mean(axis=(1, 3))


@pytest.mark.parametrize(
    ("kind", "depth"), [("EQUIRECTANGULAR", 40.0), ("FISHEYE_EQUIDISTANT", 0.8)]
)
def test_pinhole_pictures_are_found_in_it(shot, kind: str, depth: float) -> None:
    """With a mesh in front of the Gaussians, or behind them."""
    from roigs_addon import rendering
    from roigs_addon.scene import cameras

    scene, f12 = shot
    data, render = scene.camera.data, scene.render
    render.resolution_percentage = 300  # each is looked up between pixels, then made smaller
    pinhole = f12(depth)
    lens = cameras.intrinsics_of(data, render, *cameras.render_size(render))
    render.pixel_aspect_x = render.pixel_aspect_y = 1
    render.resolution_percentage = 100
    data.type, shifted = "PANO", (data.shift_x, data.shift_y)
    settings = data if hasattr(data, "panorama_type") else data.cycles
    settings.panorama_type = kind
    side = 2 * round(np.pi * lens.fx / 2)
    y, x = np.mgrid[: lens.height, : lens.width] + 0.5
    x, y = (x - lens.cx) / lens.fx, (y - lens.cy) / lens.fy
    if kind == "EQUIRECTANGULAR":
        render.resolution_x, render.resolution_y = 2 * side, side
        across, down = np.arctan(x), np.arctan(y / np.hypot(x, 1))
    else:
        render.resolution_x = render.resolution_y = side
        settings.fisheye_fov = np.pi
        across, down = (v * np.arctan(np.hypot(x, y)) / np.hypot(x, y) for v in (x, y))
    whole = f12(depth)
    assert not rendering.problem
    height, width = whole.shape[:2]
    places = (
        across * side / np.pi + width * (0.5 - shifted[0]),
        down * side / np.pi + height * (0.5 + shifted[1]),
    )
    seen = looked_up(whole, *places)
    assert pinhole[..., 3].std() > 0.1
    found, wanted = (srgb(smaller(picture)[..., :3]) for picture in (seen, pinhole))
    assert psnr(found, wanted) > 38


def test_what_cannot_be_drawn_is_said(shot) -> None:
    from roigs_addon import rendering

    scene, f12 = shot
    data = scene.camera.data
    data.type = "PANO"
    settings = data if hasattr(data, "panorama_type") else data.cycles
    settings.panorama_type = "MIRRORBALL"
    f12(0.8)
    assert "fisheye" in rendering.problem
    settings.panorama_type = "EQUIRECTANGULAR"
    scene.render.use_motion_blur = True
    f12(0.8)
    assert "motion blur" in rendering.problem
