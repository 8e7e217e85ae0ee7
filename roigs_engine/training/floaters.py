"""Finds floaters: Gaussians in the air that photos cannot constrain (ours).

Three rules find them. docs/method.md explains each: "Multi-view consistency", "Views between the
photos", "In the air among the cameras".
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from torch import Tensor

from ..context import QUIET, Context
from ..model.gaussians import Gaussians
from ..model.ownership import owners
from ..model.roi import OrientedBox
from ..model.scene import Float64, PosedImage
from ..rasterize.view import View, blending_weights
from .photo_order import evenly_spaced

SIDE = 256  # pixels of a view's longer side; enough for shares of a view
NEAREST = 0.25  # least distance of a view from the scene, as a share of its photos' distances
MORE = NEAREST**-2
"""A Gaussian is a floater if it fills this many times more of a view than of any photo: no surface
does, however near."""
LEAST = 1e-3  # least share of a view that is examined
FAINT = 1 / 255  # share of a pixel's light below which nothing is shown
POINTS = 10  # the scene begins at the tenth nearest point, so that outliers do not count
NEARER = 1.5  # this many times nearer to a camera than to the scene is in the air
MUCH_NEARER = 2.0  # the same, among the cameras
NEIGHBOURS = 4
WIDEST = 72.0  # largest angle in degrees between two photos that get views between them
MOST_VIEWS = 200
BESIDE = 0.25  # distance of a view beside a photo, as a share of the distance to the nearest photo


Poses = list[tuple[tuple[int, ...], Float64]]
"""Positions of the photos that a view lies between or beside, and its world_to_camera."""


def floaters(
    gaussians: Gaussians,
    images: Sequence[PosedImage],
    rois: Sequence[OrientedBox],
    points: Float64,
    min_views: int,
    context: Context = QUIET,
) -> Tensor:
    """(N,) bool: which Gaussians are floaters; arguments as for `consistent_across_views`."""
    found = ~consistent_across_views(gaussians, images, rois, points, min_views, context)
    shown = largest_shares(gaussians, photo_views(images), context)
    found |= fills_only_between(gaussians, views_between(images, points), shown, context)
    return found | hangs_among_cameras(gaussians, images, points, shown)


@torch.no_grad()
def consistent_across_views(
    gaussians: Gaussians,
    images: Sequence[PosedImage],
    rois: Sequence[OrientedBox],
    points: Float64,
    min_views: int,
    context: Context = QUIET,
) -> Tensor:
    """(N,) bool: which Gaussians to keep.

    A photo shows a Gaussian if its alpha x T is 1/255 or more on some pixel.

    Args:
        gaussians: the model, N rows.
        images: the training photos; their pixels are not used.
        rois: the boxes.
        points: (P, 3) of the scene, world units; the photos' `point_indices` are rows of it.
        min_views: number of photos that must show a Gaussian in front; all photos if there are
            fewer. In front means: in each photo that shows it, it is nearer than the nearest box;
            or it is in the air and nearer than half of the points that the photo observes. In a
            photo that sees no box, or observes no points, nothing is nearer.
    """
    means = gaussians.means
    shown_by = torch.zeros(len(gaussians), dtype=torch.int32, device=means.device)
    before_boxes = torch.ones_like(shown_by, dtype=torch.bool)
    before_scene = before_boxes.clone()
    min_views = min(min_views, len(images))
    views = [(image.camera, image.world_to_camera) for image in images]
    for image, weights in zip(images, blending_weights(gaussians, views, context), strict=True):
        pose = torch.from_numpy(image.world_to_camera).to(means)
        shown = weights.largest >= FAINT
        depth = means @ pose[2, :3] + pose[2, 3]
        shown_by += shown
        before_boxes &= ~shown | (depth < _nearest(rois, image))
        before_scene &= ~shown | (depth < _middle(points, image))
    in_front = before_boxes | (before_scene & in_the_air(gaussians, images, points, NEARER))
    floating = (shown_by > 0) & (shown_by < min_views) & in_front
    hidden = (shown_by == 0) & (owners(gaussians, rois) >= 0)
    return ~(floating | hidden)


def _nearest(rois: Sequence[OrientedBox], image: PosedImage) -> float:
    """Return the depth of the nearest corner of all boxes; negative if it is behind the camera.

    Minus infinity if the photo sees no box, so nothing is nearer.
    """
    pose = image.world_to_camera
    if not any(roi.projected_area(image.camera, pose) for roi in rois):
        return -np.inf
    corners = np.concatenate([roi.corners() for roi in rois])
    return float((corners @ pose[2, :3] + pose[2, 3]).min())


def _middle(points: Float64, image: PosedImage) -> float:
    """Return the median depth of the points that the photo observes; minus infinity without any."""
    if len(points) == 0 or len(image.point_indices) == 0:
        return -np.inf
    pose = image.world_to_camera
    return float(np.median(points[image.point_indices] @ pose[2, :3] + pose[2, 3]))


def views_between(images: Sequence[PosedImage], points: Float64) -> tuple[View, ...]:
    """Return views between neighbouring photos, and beside each photo.

    They stand at a quarter, a half and three quarters of the way to a neighbour. Others stand left,
    right, above and below a photo, at a quarter of the distance to the nearest photo.

    Returns:
        At most `MOST_VIEWS` of each kind, evenly spread; none for a single photo.
    """
    poses = [
        *evenly_spaced(poses_between(images), MOST_VIEWS),
        *evenly_spaced(_poses_beside(images), MOST_VIEWS),
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
        shown: (N,) the largest share of a photo that each fills (`largest_shares`).
        context: checked for cancellation.
    """
    filled = largest_shares(gaussians, views, context)
    return (filled > LEAST) & (filled > MORE * shown)


def _neighbours(images: Sequence[PosedImage]) -> list[tuple[int, int]]:
    """Return pairs of photos with similar places and directions: each with its nearest ones."""
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
    """Return the indices of two photos, and poses on the way from the first to the second."""
    pairs = _neighbours(images)
    shares = (0.5,) if len(pairs) * 3 > MOST_VIEWS else (0.25, 0.5, 0.75)
    return [
        ((first, second), _between(images[first], images[second], share))
        for first, second in pairs
        for share in shares
    ]


def _poses_beside(images: Sequence[PosedImage]) -> Poses:
    """Return the index of each photo, with its pose moved to each of four sides."""
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


def hangs_among_cameras(
    gaussians: Gaussians, images: Sequence[PosedImage], points: Float64, shown: Tensor
) -> Tensor:
    """(N,) bool: which Gaussians are in the air among the cameras, and hardly shown by photos.

    `shown` is (N,), the largest share of a photo that each fills. Without points, there are none.
    """
    if len(points) == 0:
        return torch.zeros_like(shown, dtype=torch.bool)
    means = _array(gaussians.means)
    distance, nearest = cKDTree([image.centre for image in images]).query(means)
    # the area of a Gaussian that is seen from its broad side is 2 pi s1 s2
    scales = _array(gaussians.log_scales.exp().sort(dim=1).values)
    opacity = _array(gaussians.logit_opacities.sigmoid())
    cameras = [image.camera for image in images]
    # the share of each photo that a unit area fills at unit distance
    zoom = np.array([c.fx * c.fy / (c.width * c.height) for c in cameras])[nearest]
    area = 2 * np.pi * scales[:, 1] * scales[:, 2] * zoom
    with np.errstate(divide="ignore"):  # a Gaussian exactly at a camera
        filled = opacity * np.minimum(area / distance**2, 1.0)
    seen = shown.cpu().numpy()
    unseen = (filled > LEAST) & (filled > MORE * seen)
    return torch.from_numpy(unseen).to(shown.device) & in_the_air(
        gaussians, images, points, MUCH_NEARER
    )


def _array(tensor: Tensor) -> Float64:
    return tensor.detach().cpu().numpy().astype(np.float64)


@torch.no_grad()
def largest_shares(gaussians: Gaussians, views: Iterable[View], context: Context = QUIET) -> Tensor:
    """(N,) the largest share of a view's light from each Gaussian, 0 to 1."""
    views = list(views)
    largest = torch.zeros(len(gaussians), device=gaussians.means.device)
    for (camera, _), weights in zip(
        views, blending_weights(gaussians, views, context), strict=True
    ):
        torch.maximum(largest, weights.total / (camera.width * camera.height), out=largest)
    return largest


def photo_views(images: Sequence[PosedImage]) -> list[View]:
    """Return the photos' own views, at a small size."""
    return [(image.camera.thumbnail(SIDE), image.world_to_camera) for image in images]


def shown_by(
    gaussians: Gaussians, images: Sequence[PosedImage], context: Context = QUIET
) -> Tensor:
    """(N,) bool: which Gaussians the photos show, with any visible share of a view's light."""
    shares = largest_shares(gaussians, photo_views(images), context)
    return shares > FAINT / SIDE**2


def reach(places: Float64, points: Float64) -> Float64:
    """(N, 3) -> (N,) distances to the scene, its tenth nearest point; infinite without points."""
    if len(points) == 0:
        return np.full(len(places), np.inf)
    distances, _ = cKDTree(points).query(places, k=[min(POINTS, len(points))])
    return np.asarray(distances[:, 0])


def in_the_air(
    gaussians: Gaussians, images: Sequence[PosedImage], points: Float64, times: float
) -> Tensor:
    """(N,) bool: which Gaussians' centres are `times` nearer to a camera than to the scene.

    Without points, there are none.
    """
    device = gaussians.means.device
    if len(points) == 0:
        return torch.zeros(len(gaussians), dtype=torch.bool, device=device)
    means = _array(gaussians.means)
    distance, _ = cKDTree([image.centre for image in images]).query(means)
    return torch.from_numpy(times * distance < reach(means, points)).to(device)
