"""Coverage of a box by photos: 0 to 1 for each patch of its surface and each direction.

A photo v that sees the patch p from the direction d_v measures the appearance of p from there. Its
precision grows with its pixels on the patch:

    q(v, p) = (s_v rho / rho*)^2 cos(theta),   rho = f / z pixels per unit of length
    I(p, b) = sum_v q(v, p) exp(-angle(b, d_v)^2 / (2 sigma^2))
    known(p, b) = I / (1 + I)

theta is the angle to the patch's normal, s_v <= 1 the sharpness of the photo at the box, rho* the
resolution of the usual lens where the box just fills its picture. Precisions of independent
measurements add up, and I / (1 + I) is the share by which they reduce a variance of 1. The error of
a patch as seen from b also depends on photos from nearby directions, less with the angle. sigma is
the spacing of the directions b, which are spread evenly over the sphere.

`known` is shown to users. Photos are chosen by the error in decibels, because it is later measured
in decibels: by the mean of 10 log10(1 + I), the reduction of the variance by the photos. This is a
concave function of sums, so it is monotone and submodular in the photos. `known` is, too, but it
counts closing the first half of a gap more than closing the rest.

Means are over patches and directions, each weighted by cos(theta), its share of a picture from
there. Directions without a possible camera have weight 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..model.roi import OrientedBox
from ..model.scene import Camera, Float64, PosedImage, SfmScene, project
from ..model.visibility import Candidates
from ..selection.coverage import fibonacci_directions
from .patches import Patches
from .space import Space

Bools = NDArray[np.bool_]

# With 18 degrees between them, predicted and true errors agree best (notebook/guidance.md).
DIRECTIONS = 128
SPACING = float(np.sqrt(4 * np.pi / DIRECTIONS))  # radians, between neighbouring directions
MIN_COSINE = 0.1  # between a patch's normal and the view; below it, the patch counts as not seen

View = tuple[Camera, Float64]
"""A camera and its (4, 4) world_to_camera."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxMap:
    """The map of a box, and the photos that made it.

    Attributes:
        roi: the box.
        patches: P patches of its surface.
        directions: (B, 3) unit vectors from the surface to viewers.
        weights: (P, B) of each patch and direction, 1 in sum.
        information: (P, B) I of all photos.
        images: V photos that see a patch, in name order.
        seen: (P, V) whether each photo sees each patch.
        density: (P, V) pixels per world unit of the surface, across the view; 0 if not seen.
        sharpness: (V,) of each photo at the box, 0 to 1.
        reference: rho*, pixels per world unit.
        lens: the usual camera, which defines `reference`.
        space: solid and free space around the box.
    """

    roi: OrientedBox
    patches: Patches
    directions: Float64
    weights: Float64
    information: Float64
    images: tuple[PosedImage, ...]
    seen: Bools
    density: Float64
    sharpness: Float64
    reference: float
    lens: Camera
    space: Space

    @property
    def known(self) -> Float64:
        """(P, B) coverage of each patch from each direction, 0 to 1."""
        return self.information / (1 + self.information)

    @property
    def value(self) -> float:
        """The weighted mean of `known`."""
        return float((self.weights * self.known).sum())

    def decibels(self, information: Float64) -> float:
        """The expected decrease of the error compared with no photos, dB, for I (P, B)."""
        return float((self.weights * np.log10(1 + information)).sum() * 10)

    def of_directions(self) -> tuple[Float64, Float64]:
        """(B,) weight of each direction, and the coverage from there; NaN without weight."""
        weight = self.weights.sum(axis=0)
        known = (self.weights * self.known).sum(axis=0)
        return weight, np.where(weight > 0, known / np.maximum(weight, 1e-300), np.nan)

    def of_patches(self) -> Float64:
        """(P,) mean coverage of each patch over its directions; NaN if no camera can see it."""
        weight = self.weights.sum(axis=1)
        known = (self.weights * self.known).sum(axis=1)
        return np.asarray(np.where(weight > 0, known / np.maximum(weight, 1e-300), np.nan))


def usual_camera(images: Sequence[PosedImage]) -> Camera:
    """The camera of most photos; in a tie, the one that comes first."""
    cameras = [image.camera for image in images]
    counts = {camera: cameras.count(camera) for camera in dict.fromkeys(cameras)}
    return max(counts, key=lambda camera: counts[camera])


def filling_distance(roi: OrientedBox, camera: Camera) -> float:
    """Distance from the box's centre at which its circumscribed sphere just fills the picture."""
    half = min(camera.width / camera.fx, camera.height / camera.fy) / 2
    return float(roi.diagonal / 2 * np.sqrt(1 + half**-2))


def ways_to(eye: Float64, places: Float64) -> Float64:
    """(P, 3) unit vectors from places (P, 3) to an eye (3,)."""
    ways = eye - places
    ways /= np.maximum(np.linalg.norm(ways, axis=1), 1e-300)[:, None]
    return np.asarray(ways)


def sees(
    patches: Patches, space: Space, camera: Camera, world_to_camera: Float64
) -> tuple[Bools, Float64, Float64]:
    """A camera's view: (P,) visible patches, (P,) pixels per unit, (P, 3) directions to it."""
    eye = -world_to_camera[:3, :3].T @ world_to_camera[:3, 3]
    _, depth, within = project(patches.places, camera, world_to_camera)
    ways = ways_to(eye, patches.places)
    within &= np.einsum("pi,pi->p", ways, patches.normals) > MIN_COSINE
    rows = np.flatnonzero(within)
    within[rows] = ~space.hidden(patches.places[rows], eye)
    focal = np.sqrt(camera.fx * camera.fy)
    density = np.where(within, focal / np.where(within, depth, 1.0), 0.0)
    return within, density, ways


def information(patches: Patches, directions: Float64, density: Float64, ways: Float64) -> Float64:
    """(P, B) I of one photo; `density` (P,) in units of rho*, 0 if not seen; `ways` (P, 3)."""
    cosine = np.einsum("pi,pi->p", ways, patches.normals).clip(0, 1)
    rows = np.flatnonzero(density > 0)
    found = np.zeros((len(patches), len(directions)))
    angle = np.arccos(np.clip(ways[rows] @ directions.T, -1, 1))
    precision = density[rows] ** 2 * cosine[rows]
    found[rows] = precision[:, None] * np.exp(-(angle**2) / (2 * SPACING**2))
    return found


def direction_weights(patches: Patches, directions: Float64, looked_from: Float64) -> Float64:
    """(P, B) weights, 1 in sum; `looked_from`: (N, 3) unit vectors from the box to viewers.

    A direction counts if a viewer is within the spacing of the directions.
    """
    near = (directions @ looked_from.T).max(axis=1, initial=-1.0) >= np.cos(SPACING)
    cosine = patches.normals @ directions.T
    weights = np.where((cosine > MIN_COSINE) & near[None], cosine, 0.0)
    return np.asarray(weights / max(weights.sum(), 1e-300))


def box_map(
    candidates: Candidates,
    patches: Patches,
    space: Space,
    looked_from: Float64,
    *,
    scene: SfmScene,
    context: Context = QUIET,
) -> BoxMap:
    """Compute the map of a box from its photos, assuming that all are sharp.

    Args:
        candidates: the photos that observe points of the box.
        looked_from: (N, 3) unit vectors from the box to viewers, in addition to the photos.
        scene: all photos; a photo that observes no point may still see a patch.
    """
    roi = candidates.roi
    directions = fibonacci_directions(DIRECTIONS)
    images = tuple(sorted(scene.images, key=lambda image: image.name))
    lens = usual_camera(candidates.images)
    reference = float(np.sqrt(lens.fx * lens.fy)) / filling_distance(roi, lens)
    tracked = {image.name: view for view, image in enumerate(candidates.images)}
    starts = candidates.row_starts()
    seen = np.zeros((len(patches), len(images)), dtype=bool)
    density = np.zeros(seen.shape)
    for column, image in enumerate(images):
        context.check_cancelled()
        visible, pixels, _ = sees(patches, space, image.camera, image.world_to_camera)
        view = tracked.get(image.name)
        if view is not None:  # a track proves that the photo sees the point
            rows = candidates.obs_point[starts[view] : starts[view + 1]]
            proved = np.isin(patches.points, rows)
            depth = image.local(patches.places)[:, 2]
            focal = np.sqrt(image.camera.fx * image.camera.fy)
            proved &= depth > 0
            pixels = np.where(proved, focal / np.where(proved, depth, 1.0), pixels)
            visible |= proved
        seen[:, column], density[:, column] = visible, pixels
    kept = np.flatnonzero(seen.any(axis=0))
    own = np.array([images[k].centre for k in kept]).reshape(-1, 3) - roi.centre
    own /= np.maximum(np.linalg.norm(own, axis=1), 1e-300)[:, None]
    found = BoxMap(
        roi=roi,
        patches=patches,
        directions=directions,
        weights=direction_weights(patches, directions, np.concatenate([own, looked_from])),
        information=np.zeros((len(patches), len(directions))),
        images=tuple(images[k] for k in kept),
        seen=seen[:, kept],
        density=density[:, kept],
        sharpness=np.ones(len(kept)),
        reference=reference,
        lens=lens,
        space=space,
    )
    return with_sharpness(found, found.sharpness, context)


def with_sharpness(found: BoxMap, sharpness: Float64, context: Context = QUIET) -> BoxMap:
    """The map with another sharpness (V,) of its photos; visibility is not computed again."""
    total = np.zeros(found.information.shape)
    for column, image in enumerate(found.images):
        context.check_cancelled()
        ways = ways_to(image.centre, found.patches.places)
        density = found.density[:, column] * sharpness[column] / found.reference
        total += information(found.patches, found.directions, density, ways)
    return replace(found, information=total, sharpness=sharpness)
