"""Prunes what fills a view between the photos, but no photo: fog that training cannot see (ours).

With few photos, a background Gaussian can grow large beside all of them: they hardly show it, so
nothing limits it, and it covers every view between them. So cameras are put between neighbouring
photos and beside each of them, and a Gaussian goes if one of them sees much more of it than any
photo does.

Something real could fill such a view if the camera stood close to it. The limits exclude that. A
surface at distance d from the photos fills at most (d / (d / 4))^2 = 16 times as much of a view
from a quarter of the distance; cameras nearer than that to the scene's points are not used.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation
from torch import Tensor

from ...context import QUIET, Context
from ...model.gaussians import Gaussians
from ...model.scene import Float64, PosedImage
from ...rasterize.view import View
from ..spread import spread
from .view_shares import LEAST, MORE, NEAREST, SIDE, largest_shares, reach

Poses = list[tuple[tuple[int, ...], Float64]]
"""Positions of the photos that a view lies between or beside, and its world_to_camera."""

NEIGHBOURS = 4
WIDEST = 72.0  # degrees between the directions of two photos that have views between them
MOST_VIEWS = 200
BESIDE = 0.25  # distance of a view beside a photo, in distances to the nearest photo


def views_between(images: Sequence[PosedImage], points: Float64) -> tuple[View, ...]:
    """Cameras between neighbouring photos, and beside each photo.

    They stand at a quarter, a half and three quarters of the way to a neighbour; and to the left,
    the right, above and below a photo, a quarter of the distance to the nearest one away.

    Args:
        images: the photos.
        points: (P, 3) of the scene, world units.

    Returns:
        At most `MOST_VIEWS` of each kind, evenly spread; none for a photo alone.
    """
    poses = [
        *spread(poses_between(images), MOST_VIEWS),
        *spread(_poses_beside(images), MOST_VIEWS),
    ]
    centres = [image.centre for image in images]
    centres += [-pose[:3, :3].T @ pose[:3, 3] for _, pose in poses]
    far = reach(np.array(centres), points)
    return tuple(
        (images[photos[0]].camera.thumbnail(SIDE), pose)
        for (photos, pose), distance in zip(poses, far[len(images) :], strict=True)
        if distance >= NEAREST * min(far[photo] for photo in photos)
    )


def fills_only_between(
    gaussians: Gaussians, views: Sequence[View], shown: Tensor, context: Context = QUIET
) -> Tensor:
    """(N,) bool: which Gaussians fill a view between the photos, but no photo.

    Args:
        gaussians: the model, N rows.
        views: of `views_between`.
        shown: (N,) the largest share of a photo that each fills (`view_shares.py`).
        context: checked for cancellation between views.
    """
    filled = largest_shares(gaussians, views, context)
    return (filled > LEAST) & (filled > MORE * shown)


def _neighbours(images: Sequence[PosedImage]) -> list[tuple[int, int]]:
    """Pairs of photos that stand and look alike: each with its nearest ones."""
    centres = np.array([image.centre for image in images])
    forward = np.array([image.forward for image in images])
    spread = np.median(np.linalg.norm(centres - centres.mean(axis=0), axis=1))
    pairs = set()
    for k in range(len(images)):
        cosine = forward @ forward[k]
        apart = np.linalg.norm(centres - centres[k], axis=1) / max(spread, 1e-12) + 1 - cosine
        apart[cosine < np.cos(np.radians(WIDEST))] = np.inf
        apart[k] = np.inf
        order = np.argsort(apart, kind="stable")[:NEIGHBOURS]
        pairs |= {(min(k, int(j)), max(k, int(j))) for j in order if apart[j] < np.inf}
    return sorted(pairs)


def poses_between(images: Sequence[PosedImage]) -> Poses:
    """Positions of two photos, and world_to_camera on the way from the first to the second."""
    pairs = _neighbours(images)
    shares = (0.5,) if len(pairs) * 3 > MOST_VIEWS else (0.25, 0.5, 0.75)
    return [
        ((first, second), _between(images[first], images[second], share))
        for first, second in pairs
        for share in shares
    ]


def _poses_beside(images: Sequence[PosedImage]) -> Poses:
    """Position of a photo, and its world_to_camera moved to each of four sides."""
    centres = np.array([image.centre for image in images])
    poses: Poses = []
    for k, image in enumerate(images):
        apart = np.linalg.norm(np.delete(centres, k, axis=0) - centres[k], axis=1)
        for axis, side in ((0, -1), (0, 1), (1, -1), (1, 1)) if len(apart) else ():
            pose = image.world_to_camera.copy()
            pose[axis, 3] -= side * BESIDE * apart.min()
            poses.append(((k,), pose))
    return poses


def _between(first: PosedImage, second: PosedImage, share: float) -> Float64:
    """(4, 4) world_to_camera on the way from the first photo's camera to the second's."""
    start = Rotation.from_matrix(first.world_to_camera[:3, :3])
    turn = Rotation.from_matrix(second.world_to_camera[:3, :3]) * start.inv()
    rotation = (Rotation.from_rotvec(share * turn.as_rotvec()) * start).as_matrix()
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ ((1 - share) * first.centre + share * second.centre)
    return pose
