"""A small scene with photos on disk, rendered from known Gaussians by the reference rasterizer."""

from __future__ import annotations

import functools
import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from roigs_engine.model.gaussians import SH_C0, Gaussians
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage, SfmScene
from roigs_engine.photos.cache import PhotoCache
from roigs_engine.rasterize import rasterize
from roigs_engine.training import photo_order
from roigs_engine.training.stage_data import StageData
from tests.poses import look_at

CAMERA = Camera(width=64, height=48, fx=60.0, fy=60.0, cx=32.0, cy=24.0)
BOX = OrientedBox.between("thing", [-0.6, -0.6, -0.6], [0.6, 0.6, 0.6])


def truth(count: int = 300, seed: int = 0) -> Gaussians:
    """A coloured ball of Gaussians in the box and a coarse shell around it."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    inner = np.arange(count) < count // 2
    radius = np.where(inner, 0.45, 2.5)
    scale = np.where(inner, 0.07, 0.35)
    sh = np.zeros((count, 16, 3))
    sh[:, 0] = (rng.uniform(0.05, 0.95, (count, 3)) - 0.5) / SH_C0
    arrays = {
        "means": directions * radius[:, None],
        "quats": np.tile([1.0, 0, 0, 0], (count, 1)),
        "log_scales": np.repeat(np.log(scale)[:, None], 3, axis=1),
        "logit_opacities": np.full(count, 2.0),
        "sh": sh,
    }
    return Gaussians.from_arrays({name: a.astype(np.float32) for name, a in arrays.items()})


def make_scene(folder: Path, views: int = 12) -> SfmScene:
    """Photos of `truth` from a ring of cameras, written to `folder`; points at its centres."""
    model = truth()
    points = model.means.numpy().astype(np.float64)
    images = []
    for k in range(views):
        pose = _pose(k, views)
        path = folder / f"{k:03d}.png"
        path.write_bytes(_photo(k, views))
        in_camera = points @ pose[:3, :3].T + pose[:3, 3]
        seen = np.flatnonzero(in_camera[:, 2] > 0.1)
        images.append(
            PosedImage(
                name=path.name,
                path=path,
                camera=CAMERA,
                world_to_camera=pose,
                point_indices=seen.astype(np.int64),
            )
        )
    colors = ((model.sh[:, 0].numpy() * SH_C0 + 0.5) * 255).astype(np.uint8)
    return SfmScene(images=tuple(images), points=points, colors=colors)


def _pose(k: int, views: int) -> np.ndarray:
    angle = 2 * np.pi * k / views
    return look_at(np.array([np.cos(angle), np.sin(angle), 0.35]) * (1.5 + 0.3 * (k % 3)))


@functools.cache
def _photo(k: int, views: int) -> bytes:
    """A photo's PNG, rendered once in a process: many modules' tests make the scene."""
    model = truth()
    output = rasterize(
        model.means,
        model.quats,
        model.log_scales,
        model.logit_opacities,
        model.sh,
        torch.from_numpy(_pose(k, views)).float()[None],
        torch.from_numpy(CAMERA.matrix()).float()[None],
        CAMERA.width,
        CAMERA.height,
        raw=True,
        backend="reference",
    )
    pixels = (output.image[0].clamp(0, 1) * 255).round().byte().numpy()
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, format="PNG")
    return file.getvalue()


def stage_data(scene: SfmScene, seed: int = 3, **changes: Any) -> StageData:
    """Data to train on whole photos, each once per round; `changes` are fields of it."""
    data = StageData(
        images=scene.images,
        photos=PhotoCache(scene.images),
        photo_at=photo_order.shuffled(range(len(scene.images)), seed),
        extent=scene.extent(),
    )
    return replace(data, **changes)
