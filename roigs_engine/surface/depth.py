"""Depth maps of a box: the depth of its surface in each photo that shows it."""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage

from ..context import QUIET, Context
from ..formats.events import StageStarted
from ..model.gaussians import Gaussians
from ..model.roi import OrientedBox
from ..model.scene import Camera, Float64, PosedImage, SfmScene
from ..photos.mask_images import HALF, load_mask, load_object_mask, resized
from ..rasterize.limits import PICTURE_LIMITS
from ..rasterize.view import rasterize_view

STAGE = "depth"
MARGIN = 2  # pixels around the box's silhouette

Float32 = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthMap:
    """The depth of the surface in the part of a photo that shows a box.

    Attributes:
        image: the photo.
        x, y: place of the part's first pixel in the photo.
        camera: camera of the part, in the photo's pixels.
        depth: (H, W) along the camera's z axis, units of the scene; 0 if unknown. May have fewer
            pixels than the part.
        weight: (H, W) certainty of the depth, 0 to 1; negative where masks show that the depth is
            not the object's.
    """

    image: PosedImage
    x: int
    y: int
    camera: Camera
    depth: Float32
    weight: Float32

    @property
    def world_to_camera(self) -> Float64:
        """Return the photo's pose (4, 4)."""
        return self.image.world_to_camera

    def counted(self, around: int) -> NDArray[np.bool_] | None:
        """(H, W) the part's pixels whose `around` x `around` neighbours are all used; None: all.

        The photo's mask tells which pixels are used; raises as `load_mask`.
        """
        mask = load_mask(self.image)
        if mask is None:
            return None
        part = mask[self.y : self.y + self.camera.height, self.x : self.x + self.camera.width]
        return np.asarray(ndimage.minimum_filter(part, around))

    @property
    def lens(self) -> Camera:
        """Return the camera of the depth's pixels."""
        height, width = self.depth.shape
        return self.camera.resized(width, height)


def depth_maps(
    gaussians: Gaussians,
    scene: SfmScene,
    roi: OrientedBox,
    photos: Collection[str],
    context: Context = QUIET,
    *,
    coarser: float = 1.0,
    masked: bool = False,
) -> Iterator[DepthMap]:
    """Yield the depth map of each of these photos that shows the box, in the scene's order.

    The depth is the median depth of the Gaussians, the weight is alpha.

    Args:
        gaussians: the trained scene, on the context's device.
        scene: contains the photos, in the frame of the Gaussians and the box.
        photos: names of the photos.
        coarser: size of the depth map's pixels, in pixels of the photos.
        masked: whether the Gaussians are `painted`, and photos may have masks of the object.

    If `masked`, raises the errors of `load_mask`.
    """
    images = [
        (image, window)
        for image in scene.select(set(photos)).images
        if (window := box_window(roi, image)) is not None
    ]
    started = time.monotonic()
    if images:
        context.emit(StageStarted(stage=STAGE, total=len(images)))
    for done, (image, window) in enumerate(images):
        context.check_cancelled()
        yield _rendered(gaussians, image, window, coarser, roi.name if masked else None)
        context.progress(STAGE, done + 1, len(images), started)


def box_window(roi: OrientedBox, image: PosedImage) -> tuple[int, int, int, int] | None:
    """Return the pixels around a box in a photo: x0, y0, x1, y1, end exclusive; None if unseen."""
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
    return (x0, y0, x1, y1) if min(x1 - x0, y1 - y0) > 0 else None


def cropped(camera: Camera, window: tuple[int, int, int, int]) -> Camera:
    """Return the camera of a part of its picture: x0, y0, x1, y1, end exclusive."""
    x0, y0, x1, y1 = window
    return replace(camera, width=x1 - x0, height=y1 - y0, cx=camera.cx - x0, cy=camera.cy - y0)


@torch.no_grad()
def _rendered(
    gaussians: Gaussians,
    image: PosedImage,
    window: tuple[int, int, int, int],
    coarser: float = 1.0,
    masked: str | None = None,
) -> DepthMap:
    """Render the depth map; `masked` is the box for whose object the Gaussians are painted."""
    camera = cropped(image.camera, window)
    sides = (max(1, round(side / coarser)) for side in (camera.width, camera.height))
    output = rasterize_view(
        gaussians,
        camera.resized(*sides),
        image.world_to_camera,
        limits=PICTURE_LIMITS,
        sh_degree=0,  # only the colours of `painted` matter, if any
        with_surface=True,
    )
    assert output.surface is not None
    alpha = output.alpha[0].clamp(0, 1)
    depth_map = DepthMap(
        image=image,
        x=window[0],
        y=window[1],
        camera=camera,
        depth=output.surface.median[0].cpu().numpy(),
        weight=alpha.cpu().numpy(),
    )
    if masked is None:
        return depth_map
    return _with_mask(depth_map, output.image[0, ..., 0].cpu().numpy(), masked)


def _with_mask(depth_map: DepthMap, white: Float32, box: str) -> DepthMap:
    """Make weights negative beside the object, by the photo's mask or, without one, by `white`."""
    m, camera = depth_map, depth_map.camera
    shown = white > 0.5 * m.weight
    mask = load_object_mask(m.image, box)
    if mask is not None:
        part = mask[m.y : m.y + camera.height, m.x : m.x + camera.width]
        shown = resized(part, (m.lens.width, m.lens.height), HALF)
    return replace(m, weight=np.where(shown, m.weight, -m.weight))
