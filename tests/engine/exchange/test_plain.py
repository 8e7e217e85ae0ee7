"""Anti-aliased models for viewers without anti-aliasing: right from where the photos are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from roigs_engine.exchange.transform import without_antialiasing
from roigs_engine.formats.targets import PLAIN, VIEWERS
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.rasterize.view import render_view

CAMERA = Camera(width=64, height=48, fx=60.0, fy=60.0, cx=32.0, cy=24.0)


def cloud() -> Gaussians:
    """Gaussians of 0.05 to 2 px from 4 away; opaque ones do not hide each other much."""
    random = np.random.default_rng(0)
    arrays = {
        "means": random.normal(scale=0.5, size=(300, 3)),
        "quats": random.normal(size=(300, 4)),
        "log_scales": random.uniform(np.log(0.003), np.log(0.12), (300, 3)),
        "logit_opacities": random.uniform(-2, 2, 300),
        "sh": random.normal(scale=0.4, size=(300, 1, 3)),
    }
    return Gaussians.from_arrays(arrays, target=VIEWERS)


def photo(distance: float, angle: float = 0.0) -> PosedImage:
    pose = np.eye(4)
    pose[:3, :3] = [
        [np.cos(angle), 0, np.sin(angle)],
        [0, 1, 0],
        [-np.sin(angle), 0, np.cos(angle)],
    ]
    pose[2, 3] = distance
    return PosedImage(
        name="a.jpg",
        camera=CAMERA,
        world_to_camera=pose,
        path=Path("a.jpg"),
        point_indices=np.zeros(0, np.int64),
    )


def error(model: Gaussians, image: PosedImage) -> float:
    """Against the anti-aliased picture."""
    wanted = render_view(cloud(), image.camera, image.world_to_camera).image
    drawn = render_view(model, image.camera, image.world_to_camera).image
    return float((drawn - wanted).square().mean().sqrt())


def test_it_is_the_same_picture_from_a_single_photo() -> None:
    image = photo(4.0)
    made = without_antialiasing(cloud(), [image])
    assert not made.antialiased
    assert error(replace(cloud(), target=PLAIN), image) > 0.05
    assert error(made, image) < 1e-3


def test_it_is_nearly_the_same_from_many() -> None:
    ring = [photo(4.0, angle) for angle in np.linspace(0, 6, 12)]
    made, kept = without_antialiasing(cloud(), ring), replace(cloud(), target=PLAIN)
    between = photo(4.0, 0.3)
    assert error(made, between) < 0.4 * error(kept, between)


def test_what_no_photo_shows_stays() -> None:
    model = cloud()
    behind = photo(-40.0)
    made = without_antialiasing(model, [behind])
    torch.testing.assert_close(made.logit_opacities, model.logit_opacities)
    assert made.logit_opacities is not model.logit_opacities
