"""Places in a photo's file, and in what its pinhole camera sees."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from roigs_engine.colmap.photo_pixels import photo_pixels
from roigs_engine.colmap.project import load_colmap
from roigs_engine.photos.decode import load_photo
from tests.engine.synthetic_colmap import camera, project, write_project

LENSES = {
    "pinhole": camera(),
    "distorted": camera("SIMPLE_RADIAL", params=[100.0, 48.0, 36.0, 0.15]),
}


@pytest.mark.parametrize("lens", LENSES)
def test_places_pixels_and_masks_agree_with_training(tmp_path: Path, lens: str) -> None:
    made = write_project(tmp_path / "scene", cameras=[LENSES[lens]], dots=True)
    scene = load_colmap(made.folder, pixels=False)
    photo = photo_pixels(made.folder / "sparse/0", scene.images)["b.png"]
    image = load_colmap(made.folder).image("b.png")
    assert photo.camera == image.camera
    assert np.abs(photo.pixels().astype(int) - load_photo(image)).max() <= 2
    pose = made.poses[1]
    local = made.points @ pose[:3, :3].T + pose[:3, 3]
    wanted = local[:, :2] / local[:, 2:] * (photo.camera.fx, photo.camera.fy)
    wanted += (photo.camera.cx, photo.camera.cy)
    in_file = project(LENSES[lens], local)
    there = np.isfinite(in_file).all(axis=1)
    found, unit = photo.to_camera(in_file[there])
    assert np.abs(found - wanted[there]).max() < 0.05 and 0.8 < unit < 1.3
    mask = np.zeros((photo.camera.height, photo.camera.width), bool)
    mask[20:50, 30:60] = True
    whole = photo.in_file(mask)
    assert whole.shape == (72, 96)
    back = photo.of_file(whole)
    assert (back & mask).sum() / (back | mask).sum() > 0.9
