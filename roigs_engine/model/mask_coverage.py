"""Effect of masks on a box: counted pixels, useful masks of objects, points on the object."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..formats.text import counted, named
from .roi import AREA_SIDE, OrientedBox
from .scene import Camera, Float64, PhotoMask, PosedImage, SfmScene, project


def counted_pixels(roi: OrientedBox, image: PosedImage, *, whole: bool = False) -> float:
    """Number of pixels in the box's silhouette that count; measured on a thumbnail.

    If the photo has a mask of the box's object, only the object's pixels count, unless `whole`.
    """
    of_object = None if whole else image.objects.get(roi.name)
    masks = [mask for mask in (image.mask, of_object) if mask is not None]
    if not masks:
        return roi.projected_pixels(image.camera, image.world_to_camera)
    camera = image.camera.thumbnail(AREA_SIDE)
    first, *others = (_small(mask, camera) for mask in masks)
    shown = (roi.silhouette(camera, image.world_to_camera) * first).astype(np.float64)
    for other in others:
        shown *= other / 255.0
    share = float(shown.mean()) / 255
    return share * image.camera.width * image.camera.height


def object_share(roi: OrientedBox, image: PosedImage) -> float | None:
    """Share of the box's pixels that show its object; None without a mask, or without such pixels.

    The pixels are those of `counted_pixels`.
    """
    whole = counted_pixels(roi, image, whole=True) if roi.name in image.objects else 0.0
    return counted_pixels(roi, image) / whole if whole else None


def _small(mask: PhotoMask, camera: Camera) -> NDArray[np.uint8]:
    """The mask at the size of a thumbnail's camera."""
    # The mask is for the photo's full size; the camera may be for a smaller copy.
    rows = np.arange(camera.height) * mask.small.shape[0] // camera.height
    columns = np.arange(camera.width) * mask.small.shape[1] // camera.width
    return np.asarray(mask.small[np.ix_(rows, columns)])


HALF = 128  # least value of an object's pixel in a small mask


def with_useful_masks(
    scene: SfmScene, rois: Sequence[OrientedBox], context: Context = QUIET
) -> SfmScene:
    """Remove masks of objects that show nothing in their box.

    Reports the number of masks for each box, and warns of removed ones.
    """
    useless: dict[str, set[str]] = {}
    for roi in rois:
        there = [image for image in scene.images if roi.name in image.objects]
        names = [image.name for image in there if not object_share(roi, image)]
        useless[roi.name] = set(names)
        if len(there) > len(names):
            photos = counted(len(there) - len(names), "photo")
            context.info(f"Box '{roi.name}': masks of the object on {photos}.")
        if names:
            verb = "shows" if len(names) == 1 else "show"
            context.warn(
                f"Box '{roi.name}': {counted(len(names), 'mask')} {verb} nothing in the box and"
                f" {'is' if len(names) == 1 else 'are'} not used:"
                f" {named(names)}. White is the object, black all else."
            )
    images = []
    for image in scene.images:
        useful = {
            box: mask
            for box, mask in image.objects.items()
            if image.name not in useless.get(box, {image.name})
        }
        images.append(image if useful == image.objects else replace(image, objects=useful))
    return replace(scene, images=tuple(images))


def object_points(
    points: Float64, roi: OrientedBox, images: Iterable[PosedImage]
) -> NDArray[np.bool_]:
    """(P, 3) points in the box -> (P,) whether they are on the object, by the photos' masks.

    Each mask that a point projects into votes. A point is rejected if most votes are against it.
    Points without votes are kept.
    """
    votes = np.zeros(len(points), dtype=np.int64)
    for image in images:
        mask = image.objects.get(roi.name)
        if mask is None:
            continue
        pixels, _, seen = project(points, image.camera, image.world_to_camera)
        x, y = (pixels[seen] / (image.camera.width, image.camera.height)).T
        rows, columns = mask.small.shape
        shown = mask.small[(y * rows).astype(int), (x * columns).astype(int)] >= HALF
        votes[seen] += np.where(shown, 1, -1)
    return np.asarray(votes >= 0)
