"""Captures with photos added by a rule: guided, even, random. Poses only; nothing is rendered."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.few_photos import Case, cut
from roigs_engine.colmap.project import load_colmap
from roigs_engine.guidance.box_map import filling_distance
from roigs_engine.guidance.known import KnownBox, known_box
from roigs_engine.guidance.suggest import suggested
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, Float64, PosedImage, SfmScene
from roigs_engine.model.visibility import observed_points
from roigs_engine.photos.headers import content_digest

ARMS = ("guide", "even", "random")
RING = 1.01  # of the nearest distance: the shell that even and random photos are taken from
Shots = dict[str, list[list[float]]]
"""Name -> camera to world (4, 4), OpenCV axes."""


def true_pose(known: Mapping[str, Any]) -> Float64:
    """(4, 4) world_to_camera of a photo in a truth.json of the demo."""
    pose = np.eye(4)
    pose[:3, :3] = np.array(known["rotation"]).T
    pose[:3, 3] = -pose[:3, :3] @ np.array(known["centre"])
    return pose


def true_capture(demo: Path, max_side: int) -> SfmScene:
    """The demo's scene with the true cameras of its photos, at a size."""
    scene, truth = load_colmap(demo), json.loads((demo / "truth.json").read_text())
    focal = truth["focal"]
    images = []
    for image in scene.images:
        known = truth["photos"][image.name]
        pose = true_pose(known)
        width, height = image.camera.width, image.camera.height
        camera = Camera(
            width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2
        ).thumbnail(max_side)
        images.append(replace(image, camera=camera, world_to_camera=pose))
    return replace(scene, images=tuple(images))


def start_of(scene: SfmScene, box: OrientedBox, count: int, seed: int) -> SfmScene:
    """The capture that a draw begins with: photos at random, points that two of them observe."""
    return cut(scene, box, Case(scene="demo", kind="random", count=count, seed=seed))


def shots_of(arm: str, known: KnownBox, count: int, seed: int) -> list[Float64]:
    """(4, 4) world_to_camera of the photos that an arm takes of a box.

    Even and random photos are of the nearest ring of the guide's own places: all photos of a draw
    are as near, and stand where a person can stand.
    """
    if arm == "guide":
        return [shot.world_to_camera for shot in suggested(known, count)]
    found, poses = known.map, known.places.poses
    away = np.linalg.norm(known.places.centres - found.roi.centre, axis=1)
    rows = np.flatnonzero(away <= RING * filling_distance(found.roi, found.lens))
    rng = np.random.default_rng([seed, len(found.roi.name)])
    if arm == "random":
        return list(poses[rng.choice(rows, min(count, len(rows)), replace=False)])
    ways = known.places.centres[rows]
    order: list[int] = []
    first = int(rng.integers(len(rows)))
    while len(order) < min(count, len(rows)):
        order.append(first)
        nearest = np.linalg.norm(ways[:, None] - ways[order], axis=2).min(axis=1)
        first = int(nearest.argmax())
    return list(poses[rows[order]])


def planned(
    start: SfmScene, boxes: Sequence[OrientedBox], arm: str, count: int, seed: int
) -> Shots:
    """The photos that an arm takes of all boxes."""
    shots: Shots = {}
    for box in boxes:
        for number, pose in enumerate(shots_of(arm, known_box(start, box), count, seed)):
            shots[f"{box.name}_{number:02d}.jpg"] = np.linalg.inv(pose).tolist()
    return shots


def with_photos(start: SfmScene, folder: Path, camera: Camera, label: str) -> SfmScene:
    """The capture with a folder's rendered photos, which observe as many points as the others."""
    shots: Mapping[str, list[list[float]]] = json.loads((folder / "shots.json").read_text())
    images = []
    for name, matrix in shots.items():
        path = folder / "images" / name
        digest = content_digest(path)
        images.append(
            PosedImage(
                name=f"{label}/{name}",
                path=path,
                camera=camera,
                world_to_camera=np.linalg.inv(np.array(matrix)),
                digest=digest,
                file_digest=digest,
            )
        )
    more = replace(start, images=(*start.images, *images))
    visible = observed_points(replace(more, has_tracks=False))
    # Features are matched in some of the photos that see a point: as many as in the others.
    tracked = sum(len(image.point_indices) for image in start.images)
    share = tracked / max(1, sum(map(len, visible[: len(start.images)])))
    rng = np.random.default_rng(0)
    added = [
        replace(image, point_indices=np.sort(rng.choice(rows, round(share * len(rows)), False)))
        for image, rows in zip(images, visible[len(start.images) :], strict=True)
    ]
    everything = sorted((*start.images, *added), key=lambda image: image.name)
    return replace(start, images=tuple(everything))
