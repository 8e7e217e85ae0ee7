"""Finds places from which a person can photograph a box, from the places of existing photos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..context import QUIET, Context
from ..formats.gravity import gravity_alignment, rotation_between
from ..model.roi import OrientedBox
from ..model.scene import Camera, Float64, PosedImage, SfmScene, project
from .box_map import filling_distance
from .space import Space

SPACING = np.radians(8)  # between neighbouring places, as seen from the box
SHELLS = 4  # distances at most
NEAR = 0.5  # of the distance to the box: how far a person may move from a photo's place
STEEPEST = np.radians(80)  # steeper pictures have no clear up direction
STEP = float(np.sqrt(2))  # ratio of the distances of neighbouring shells


@dataclass(frozen=True, kw_only=True, eq=False)
class Places:
    """Poses of cameras that look at a box's centre, upright.

    Attributes:
        poses: (N, 4, 4) world_to_camera.
        up: (3,) unit vector, world.
    """

    poses: Float64
    up: Float64

    @property
    def centres(self) -> Float64:
        """(N, 3) world positions."""
        turns, moves = self.poses[:, :3, :3], self.poses[:, :3, 3]
        return np.asarray(-np.einsum("nji,nj->ni", turns, moves))


def up_of(images: Sequence[PosedImage]) -> Float64:
    """(3,) up in the world, estimated from the photos."""
    poses = np.array([image.world_to_camera for image in images]).reshape(-1, 4, 4)
    return np.asarray(gravity_alignment(poses)[2])


def looking_at(eye: Float64, target: Float64, up: Float64) -> Float64:
    """(4, 4) world_to_camera of an upright camera at `eye` that looks at `target`."""
    forward = (target - eye) / max(float(np.linalg.norm(target - eye)), 1e-300)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:  # straight down: choose any direction as right
        right = np.cross(forward, np.eye(3)[int(np.abs(forward).argmin())])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = right, np.cross(forward, right), forward
    pose[:3, 3] = -pose[:3, :3] @ eye
    return pose


def standing_places(
    scene: SfmScene,
    seeing: Sequence[PosedImage],
    roi: OrientedBox,
    space: Space,
    lens: Camera,
    context: Context = QUIET,
) -> Places:
    """Find places where a person can stand and see the box: on shells, in air that rays passed.

    On the nearest shell, the box fills the picture. The farthest is at the median distance of its
    photos. Heights are limited to those of the cameras. All points are at least as far away as the
    nearest one is from any photo's camera, or half the radius of the nearest shell if that is less.

    Args:
        seeing: the photos that see the box.
    """
    up = up_of(scene.images)
    nearest = filling_distance(roi, lens)
    usual = float(np.median([np.linalg.norm(image.centre - roi.centre) for image in seeing]))
    shells = 1 + int(min(SHELLS - 1, np.log(max(usual / nearest, 1)) // np.log(STEP)))
    heights = (scene.centres() - roi.centre) @ up
    eyes = np.concatenate(
        [
            _shell(nearest * STEP**shell, (float(heights.min()), float(heights.max())))
            for shell in range(shells)
        ]
    )
    eyes = roi.centre + eyes @ rotation_between(up, np.array([0.0, 0.0, 1.0]))
    room = min(float(_room(scene, scene.centres()).min()), NEAR * nearest)
    eyes = eyes[space.is_free(eyes) & (_room(scene, eyes) >= room)]
    coarse = Space.of(scene, roi, context, coarse=True)
    reach = NEAR * np.linalg.norm(eyes - roi.centre, axis=1)
    eyes = eyes[_looked_through(scene, eyes, coarse) | _beside(scene, eyes, reach, coarse)]
    poses = [looking_at(eye, roi.centre, up) for eye in eyes]
    return Places(poses=np.array(poses).reshape(-1, 4, 4), up=up)


def _shell(radius: float, heights: tuple[float, float]) -> Float64:
    """(N, 3) evenly spaced places on a sphere around the origin, in a range of heights; z up."""
    low, high = np.arcsin(np.clip(np.array(heights) / radius, -1, 1))
    rows: list[Float64] = []
    for rise in np.linspace(low, high, 1 + int(np.ceil((high - low) / SPACING))):
        if abs(rise) > STEEPEST and low < high:
            continue
        count = max(1, round(2 * np.pi * np.cos(rise) / SPACING))
        turn = 2 * np.pi * (np.arange(count) + 0.5 * (len(rows) % 2)) / count
        flat = np.cos(rise) * np.stack([np.cos(turn), np.sin(turn)])
        rows.append(radius * np.column_stack([*flat, np.full(count, np.sin(rise))]))
    return np.concatenate([np.zeros((0, 3)), *rows])


def _looked_through(scene: SfmScene, eyes: Float64, space: Space) -> NDArray[np.bool_]:
    """(N, 3) places -> (N,) whether each is in air that photos have looked through.

    For most of the photos that have the place in view, nothing solid may be in front of it.
    """
    shown, free = np.zeros(len(eyes), dtype=int), np.zeros(len(eyes), dtype=int)
    for image in scene.images:
        rows = np.flatnonzero(project(eyes, image.camera, image.world_to_camera)[2])
        shown[rows] += 1
        free[rows] += ~space.hidden(eyes[rows], image.centre, skipped=0)
    return np.asarray(2 * free > shown)


def _beside(scene: SfmScene, eyes: Float64, reach: Float64, space: Space) -> NDArray[np.bool_]:
    """(N, 3) places -> (N,) whether a camera is within `reach`, with nothing solid between."""
    beside = np.zeros(len(eyes), dtype=bool)
    for image in scene.images:
        near = np.linalg.norm(eyes - image.centre, axis=1) <= reach
        rows = np.flatnonzero(near & ~beside)
        beside[rows] = ~space.hidden(eyes[rows], image.centre, skipped=0)
    return beside


def _room(scene: SfmScene, eyes: Float64) -> Float64:
    """(N, 3) places -> (N,) distance to the nearest sparse point."""
    from scipy.spatial import cKDTree

    points = scene.points[np.isfinite(scene.points).all(axis=1)]
    if not len(points) or not len(eyes):
        return np.zeros(len(eyes))
    return np.asarray(cKDTree(points).query(eyes)[0])


@dataclass(frozen=True, kw_only=True)
class Offset:
    """A place relative to a photo: world units along its right, up and forward."""

    photo: str
    right: float
    up: float
    forward: float


def offset_from(eye: Float64, image: PosedImage, up: Float64) -> Offset:
    """The offset of a place `eye` (3,) from a photo's camera; forward is level."""
    forward = image.forward - up * (image.forward @ up)
    if np.linalg.norm(forward) < 1e-6:
        forward = -image.world_to_camera[1, :3]
        forward = forward - up * (forward @ up)
    forward = forward / max(float(np.linalg.norm(forward)), 1e-300)
    away = eye - image.centre
    return Offset(
        photo=image.name,
        right=float(away @ np.cross(forward, up)),
        up=float(away @ up),
        forward=float(away @ forward),
    )
