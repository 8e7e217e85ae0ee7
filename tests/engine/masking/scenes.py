"""A red ball on a checked plate: photos of it from a ring, and its true masks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from roigs_engine.colmap.photo_pixels import PhotoPixels
from roigs_engine.formats.scribbles import BACKGROUND, OBJECT, Stroke
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage, SfmScene
from roigs_engine.rasterize.view import render_view
from tests.poses import look_at

WIDTH, HEIGHT, FOCAL = 112, 84, 105.0
CAMERA = Camera(width=WIDTH, height=HEIGHT, fx=FOCAL, fy=FOCAL, cx=WIDTH / 2, cy=HEIGHT / 2)
BOX = OrientedBox.between("ball", [-0.5, -0.5, -0.56], [0.5, 0.5, 0.5])
COUNT = 6
BALL, PLATE = 1500, 6000  # Gaussians


@dataclass(frozen=True, kw_only=True, eq=False)
class BallScene:
    """The scene; `true`: masks by photo."""

    model: Gaussians
    ball: torch.Tensor
    scene: SfmScene
    photos: dict[str, PhotoPixels]
    true: dict[str, np.ndarray]


def ball_scene(folder: Path) -> BallScene:
    """Render and write it."""
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(BALL, 3))
    ball *= (0.4 * rng.uniform(0, 1, BALL) ** (1 / 3) / np.linalg.norm(ball, axis=1))[:, None]
    plate = np.column_stack([rng.uniform(-1.6, 1.6, (PLATE, 2)), rng.normal(-0.45, 0.01, PLATE)])
    places = np.concatenate([ball, plate])
    colours = np.empty(places.shape)
    colours[:BALL] = (190, 70, 60)
    checked = (np.floor(plate[:, :2] * 3).sum(axis=1) % 2 > 0)[:, None]
    colours[BALL:] = np.where(checked, (70, 110, 80), (200, 205, 190))
    colours += rng.normal(0, 12, places.shape)
    model = Gaussians.from_points(places, colours.clip(0, 255).astype(np.uint8))
    model.log_scales.fill_(float(np.log(0.04)))
    model.logit_opacities.fill_(3.0)
    is_ball = torch.arange(len(places)) < BALL
    images, photos, true = [], {}, {}
    sparse = rng.choice(len(places), 900, replace=False)
    for k in range(COUNT):
        angle = 2 * np.pi * k / COUNT
        pose = look_at(np.array([2 * np.cos(angle), 2 * np.sin(angle), 1.0]))
        name = f"{k}.png"
        image = render_view(model, CAMERA, pose).image
        Image.fromarray((image.numpy() * 255).astype(np.uint8)).save(folder / name)
        alone = model.rows(is_ball)
        alone.sh.zero_()
        true[name] = render_view(alone, CAMERA, pose).image[..., 0].numpy() > 0.25
        local = places[sparse] @ pose[:3, :3].T + pose[:3, 3]
        x, y = (local[:, :2] / local[:, 2:] * FOCAL + (WIDTH / 2, HEIGHT / 2)).T
        seen = np.flatnonzero((x > 0) & (x < WIDTH) & (y > 0) & (y < HEIGHT))
        images.append(
            PosedImage(
                name=name,
                path=folder / name,
                camera=CAMERA,
                world_to_camera=pose,
                point_indices=seen.astype(np.int64),
            )
        )
        photos[name] = PhotoPixels(
            name=name, path=folder / name, size=(WIDTH, HEIGHT), camera=CAMERA, lens=None, turn=1
        )
    scene = SfmScene(
        images=tuple(images),
        points=places[sparse],
        colors=colours[sparse].clip(0, 255).astype(np.uint8),
    )
    return BallScene(model=model, ball=is_ball, scene=scene, photos=photos, true=true)


def strokes(mask: np.ndarray) -> tuple[Stroke, ...]:
    """A cross on the object and a ring around it."""
    rows, columns = np.nonzero(mask)
    middle = np.array([columns.mean(), rows.mean()])
    radius = float(np.sqrt(mask.sum() / np.pi))
    angle = np.linspace(0, 2 * np.pi, 25)[:, None]
    ring = middle + 1.3 * radius * np.hstack([np.cos(angle), np.sin(angle)])
    cross = [
        middle + 0.5 * radius * np.array(pair) for pair in ([(-1, 0), (1, 0)], [(0, -1), (0, 1)])
    ]
    return (
        *(Stroke(kind=OBJECT, width=3.0, points=line) for line in cross),
        Stroke(kind=BACKGROUND, width=3.0, points=ring),
    )


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union."""
    return float((a & b).sum() / max(1, (a | b).sum()))
