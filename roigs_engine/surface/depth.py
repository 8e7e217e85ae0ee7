"""Depth maps of a box: how far away its surface is in each photo that shows it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..formats.events import StageStarted
from ..model.gaussians import Gaussians
from ..model.roi import OrientedBox
from ..model.scene import Camera, Float64, PosedImage, SfmScene
from ..photos.decode import load_photo
from ..rasterize.limits import PICTURE_LIMITS
from ..rasterize.view import rasterize_view
from .matching import SWEEPS, Shot, matched, rays

STAGE = "depth"
MARGIN = 2  # pixels around the box's silhouette
LEAST_SIDE = 8  # pixels of a part of a photo: smaller ones have no levels to compare
OPAQUE = 0.5  # least alpha of a pixel that has a depth
WIDER = 1.1  # of the box: depth in it is compared
BEST_ANGLE, LEAST_ANGLE, MOST_ANGLE = 25.0, 5.0, 66.0  # degrees, between photos that are compared
COARSEST = 2.5  # times a photo's own pixels: those of photos it is compared with
MOST = 4  # of them
DOUBTFUL = 0.1  # weight of a depth that no other photo confirms
LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)

Float32 = NDArray[np.float32]
Load = Callable[[PosedImage], NDArray[np.uint8]]


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthMap:
    """The depth of the surface in the part of a photo that shows a box.

    Attributes:
        image: the photo.
        x, y: of the part's first pixel in the photo.
        camera: of the part.
        depth: (H, W) along the camera's z axis, units of the scene; 0: not known.
        weight: (H, W) how certain it is, 0 to 1.
        normal: (H, W, 3) unit vectors in the world that point to the camera; None: not known.
    """

    image: PosedImage
    x: int
    y: int
    camera: Camera
    depth: Float32
    weight: Float32
    normal: Float32 | None = None

    @property
    def world_to_camera(self) -> Float64:
        """(4, 4) the photo's pose."""
        return self.image.world_to_camera


def depth_maps(
    gaussians: Gaussians,
    scene: SfmScene,
    roi: OrientedBox,
    photos: Collection[str],
    context: Context = QUIET,
    *,
    load: Load = load_photo,
) -> Iterator[DepthMap]:
    """The depth map of each of these photos that shows the box, in the scene's order.

    The depth is the median one of the Gaussians, made exact where other photos confirm it
    (`matching`). The weight is how alike they look, or `DOUBTFUL` of alpha.

    Args:
        gaussians: the trained scene, on the context's device.
        scene: with the photos, in the frame of the Gaussians and the box.
        photos: names of the photos.
        load: returns a photo, (H, W, 3) uint8 sRGB.
    """
    images = [
        (image, window)
        for image in scene.select(set(photos)).images
        if (window := box_window(roi, image)) is not None
    ]
    started = time.monotonic()
    if images:
        context.emit(StageStarted(stage=STAGE, total=2 * len(images)))
    drawn: list[DepthMap] = []
    for image, window in images:
        context.check_cancelled()
        drawn.append(_rendered(gaussians, image, window))
        context.progress(STAGE, len(drawn), 2 * len(images), started)
    stacks = [_halves(depth_map, roi, load) for depth_map in drawn]
    shown = [image for image, _ in images]
    for k, depth_map in enumerate(drawn):
        context.check_cancelled()
        others = [stacks[j] for j in neighbours(k, shown, roi)]
        yield _refined(depth_map, stacks[k], others)
        context.progress(STAGE, len(drawn) + k + 1, 2 * len(images), started)


def neighbours(k: int, images: Sequence[PosedImage], roi: OrientedBox) -> list[int]:
    """The photos that are compared with the k-th: best first, `MOST` of them.

    They look at the box from the side, not too far, and their pixels are about as large; two that
    are close together tell little more than one.
    """
    away = np.array([image.centre for image in images]) - roi.centre
    distances = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
    rays = away / distances[:, None]
    angles = np.degrees(np.arccos(np.clip(rays @ rays.T, -1, 1)))
    sizes = distances / [image.camera.fx for image in images]
    ratios = sizes / sizes[k]
    score = np.exp(-(((angles[k] - BEST_ANGLE) / BEST_ANGLE) ** 2)) / np.maximum(ratios, 1)
    score[(angles[k] < LEAST_ANGLE) | (angles[k] > MOST_ANGLE) | (ratios > COARSEST)] = 0
    chosen: list[int] = []
    while len(chosen) < MOST and score.max() > 0:
        best = int(score.argmax())
        chosen.append(best)
        score *= np.where(angles[best] < LEAST_ANGLE, 0.5, 1)
        score[best] = 0
    return chosen


def _halves(depth_map: DepthMap, roi: OrientedBox, load: Load) -> list[Shot]:
    """The photo's part at each size that `matched` takes, with depth where it is in the box."""
    image, (height, width) = depth_map.image, depth_map.depth.shape
    photo = load(image)[depth_map.y :, depth_map.x :][:height, :width]
    grey = torch.from_numpy(photo.astype(np.float32) @ LUMA / 255)
    depth = torch.from_numpy(depth_map.depth) * torch.from_numpy(depth_map.weight > OPAQUE)
    directions = rays(depth_map.camera).double().numpy()
    pose = roi.world_to_box @ np.linalg.inv(image.world_to_camera)
    points = (directions * depth_map.depth[..., None]) @ pose[:3, :3].T + pose[:3, 3]
    inside = (np.abs(points) < roi.half_extents * WIDER).all(axis=-1)
    shot = Shot(
        camera=depth_map.camera,
        pose=torch.from_numpy(image.world_to_camera),
        grey=grey,
        depth=depth * torch.from_numpy(inside),
    )
    stack = [shot]
    while len(stack) < len(SWEEPS):
        stack.append(stack[-1].halved())
    return stack


def _refined(
    depth_map: DepthMap, stack: Sequence[Shot], others: Sequence[Sequence[Shot]]
) -> DepthMap:
    """The depth map with what photos tell; see `depth_maps`."""
    depth, likeness = matched(stack, others)
    rendered, alpha = torch.from_numpy(depth_map.depth), torch.from_numpy(depth_map.weight)
    depth = torch.where(stack[0].depth > 0, depth, rendered)
    weight = torch.where(likeness > 0, likeness, DOUBTFUL * alpha)
    return replace(depth_map, depth=depth.numpy(), weight=weight.numpy())


def box_window(roi: OrientedBox, image: PosedImage) -> tuple[int, int, int, int] | None:
    """x0, y0, x1, y1, end exclusive: the pixels around a box in a photo; None: it shows none."""
    camera, pose = image.camera, image.world_to_camera
    if roi.camera_inside(pose):
        return 0, 0, camera.width, camera.height
    polygon = roi.silhouette_polygon(camera, pose)
    if polygon is None:
        return None
    size = np.array([camera.width, camera.height], dtype=float)
    low = np.clip(polygon.min(axis=0) - MARGIN, 0, size)
    high = np.clip(polygon.max(axis=0) + MARGIN, 0, size)
    x0, y0 = (math.floor(value) for value in low)
    x1, y1 = (math.ceil(value) for value in high)
    return (x0, y0, x1, y1) if min(x1 - x0, y1 - y0) >= LEAST_SIDE else None


def cropped(camera: Camera, window: tuple[int, int, int, int]) -> Camera:
    """The camera of a part of its picture: x0, y0, x1, y1, end exclusive."""
    x0, y0, x1, y1 = window
    return replace(camera, width=x1 - x0, height=y1 - y0, cx=camera.cx - x0, cy=camera.cy - y0)


@torch.no_grad()
def _rendered(
    gaussians: Gaussians, image: PosedImage, window: tuple[int, int, int, int]
) -> DepthMap:
    camera = cropped(image.camera, window)
    output = rasterize_view(
        gaussians,
        camera,
        image.world_to_camera,
        limits=PICTURE_LIMITS,
        sh_degree=0,  # colours do not matter
        with_surface=True,
    )
    assert output.surface is not None
    alpha = output.alpha[0].clamp(0, 1)
    return DepthMap(
        image=image,
        x=window[0],
        y=window[1],
        camera=camera,
        depth=output.surface.median[0].cpu().numpy(),
        weight=alpha.cpu().numpy(),
    )
