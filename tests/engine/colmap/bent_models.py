"""Models whose cameras have the wrong lens model, to be refined."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

from tests.engine.synthetic_colmap import Project, camera, write_project

LENS = [200.0, 190.0, 120.0, 90.0, 0.2, -0.6, 0.0, 0.0]  # OPENCV: no SIMPLE_RADIAL is like it
POINTS = np.random.default_rng(3).uniform(-1, 1, (400, 3)) * [1.6, 1.2, 0.9]
NAMES = [f"{k:02}.png" for k in range(10)]


def bent(folder: Path, *, noise: float = 0.05, cameras: int = 1, photos: int = 10) -> Project:
    """A project whose keypoints an OPENCV lens took, and whose cameras are SIMPLE_RADIAL.

    COLMAP's own bundle adjustment has fitted the rest to that.
    """
    lenses = [camera("OPENCV", 240, 180, LENS) for _ in range(cameras)]
    made = write_project(folder, names=NAMES[:photos], cameras=lenses, points=POINTS, arc=2.0)
    model = folder / "sparse" / "0"
    scene = pycolmap.Reconstruction(str(model))
    rng = np.random.default_rng(5)
    for image in scene.images.values():
        for keypoint in image.points2D:
            keypoint.xy = keypoint.xy + rng.normal(scale=noise, size=2)
    for lens in scene.cameras.values():
        lens.model = pycolmap.CameraModelId.SIMPLE_RADIAL
        lens.params = [200.0, 120.0, 90.0, 0.0]
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    config = pycolmap.BundleAdjustmentConfig()
    for image in scene.reg_image_ids():
        config.add_image(image)
    pycolmap.create_default_bundle_adjuster(options, config, scene).solve()
    scene.transform(pycolmap.estimate_sim3d(positions(scene), POINTS))
    scene.write(str(model))
    return made


def positions(scene: pycolmap.Reconstruction) -> np.ndarray:
    """(P, 3) points in the order of their ids."""
    return np.array([scene.points3D[key].xyz for key in sorted(scene.point3D_ids())])
