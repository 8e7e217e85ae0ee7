"""The posed photos of a pycolmap reconstruction as arrays: points to pixels and sizes of pixels."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...model.scene import Float64


class Views:
    """V registered photos, in the order of their ids.

    Attributes:
        ids: of the images.
        lenses: the camera of each, pycolmap's.
        focals: (V,) mean focal lengths, px.
        centres: (V, 3) in the world.
    """

    def __init__(self, scene: Any) -> None:
        self.ids: list[int] = sorted(scene.reg_image_ids())
        self.lenses = [scene.images[key].camera for key in self.ids]
        self.focals = np.array([lens.mean_focal_length() for lens in self.lenses])
        self._poses = np.array(
            [np.asarray(scene.images[key].cam_from_world().matrix()) for key in self.ids]
        ).reshape(-1, 3, 4)
        turned = self._poses[:, :, :3].transpose(0, 2, 1)
        self.centres: Float64 = -(turned @ self._poses[:, :, 3:])[..., 0]

    def project(self, view: int, points: Float64) -> Float64:
        """(N, 3) points -> (N, 2) places in a photo, px; NaN behind the camera."""
        local = points @ self._poses[view, :, :3].T + self._poses[view, :, 3]
        local[local[:, 2] <= 0] = np.nan
        places: Float64 = np.asarray(self.lenses[view].img_from_cam(local)).reshape(-1, 2)
        return places

    def depths(self, view: int, points: Float64) -> Float64:
        """(N,) distances along the photo's axis, world units."""
        depths: Float64 = points @ self._poses[view, 2, :3] + self._poses[view, 2, 3]
        return depths

    def footprints(self, view: int, points: Float64) -> Float64:
        """(N,) what a pixel of the photo covers at each point, world units."""
        size: Float64 = self.depths(view, points) / self.focals[view]
        return size

    def jacobians(self, view: int, points: Float64, axes: Float64) -> Float64:
        """(N, 2, 2): where two short steps from each point lead in the photo, px, as columns.

        Args:
            view: row of the photo.
            points: (N, 3).
            axes: (N, 3, 2) the steps, as columns, world units.
        """
        centre = self.project(view, points)
        steps = [self.project(view, points + axes[:, :, k]) - centre for k in range(2)]
        return np.stack(steps, axis=2)
