"""How many pixels of a photo show a box, without those that the photo's mask ignores."""

from __future__ import annotations

import numpy as np

from .roi import AREA_SIDE, OrientedBox
from .scene import PosedImage


def counted_pixels(roi: OrientedBox, image: PosedImage) -> float:
    """Number of pixels in the box's silhouette that count; measured on a thumbnail."""
    if image.mask is None:
        return roi.projected_pixels(image.camera, image.world_to_camera)
    camera, small = image.camera.thumbnail(AREA_SIDE), image.mask.small
    silhouette = roi.silhouette(camera, image.world_to_camera)
    # The mask is of the photo's full size, the camera may be that of a smaller copy.
    rows = np.arange(camera.height) * small.shape[0] // camera.height
    columns = np.arange(camera.width) * small.shape[1] // camera.width
    share = float((silhouette * small[np.ix_(rows, columns)]).mean()) / 255
    return share * image.camera.width * image.camera.height
