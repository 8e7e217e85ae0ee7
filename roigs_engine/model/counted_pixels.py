"""How many pixels of a photo show a box, or its object, without those that its mask ignores."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .roi import AREA_SIDE, OrientedBox
from .scene import Camera, PhotoMask, PosedImage


def counted_pixels(roi: OrientedBox, image: PosedImage, *, whole: bool = False) -> float:
    """Number of pixels in the box's silhouette that count; measured on a thumbnail.

    In a photo with a mask of the box's object, only the object's count, unless `whole`.
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
    # The mask is of the photo's full size, the camera may be that of a smaller copy.
    rows = np.arange(camera.height) * mask.small.shape[0] // camera.height
    columns = np.arange(camera.width) * mask.small.shape[1] // camera.width
    small: NDArray[np.uint8] = mask.small[np.ix_(rows, columns)]
    return small
