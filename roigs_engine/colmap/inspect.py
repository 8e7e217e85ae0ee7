"""Inspects a scene before training: its contents, and how well photos show each box."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..formats.text import counted, printable
from ..model.roi import OrientedBox
from ..model.scene import SfmScene
from ..model.scene_checks import few_photos, scene_warnings
from ..model.visibility import observations

FIRST_NAMES = 5


def inspect_scene(scene: SfmScene, rois: Sequence[OrientedBox] = ()) -> dict[str, Any]:
    """The scene's figures, as plain values for JSON.

    Keys: `photos`; `cameras` (distinct intrinsics); `smallest`, `largest` ([width, height] in
    pixels, by area); `skipped` (reason -> {count, first}); `points`; `stray_points` (left out, far
    from all cameras); `observations`; `has_tracks`; `extent` (scene.extent(), world units);
    `bounds` ([low, high] corners of the middle 98 % of the points); `rois`, one entry each (see
    `inspect_roi`); `warnings` (sentences on problems for training, usually none).
    """
    cameras = {image.camera for image in scene.images}
    boxes = [inspect_roi(scene, roi) for roi in rois]
    warnings = scene_warnings(scene, rois)
    for box in boxes:
        warnings += few_photos(box["name"], box["photos"], points=box["points"])
    sizes = sorted({(c.width, c.height) for c in cameras}, key=lambda size: size[0] * size[1])
    bounds = np.percentile(scene.points, (1, 99), axis=0) if len(scene.points) else np.zeros((2, 3))
    return {
        "photos": len(scene.images),
        "cameras": len(cameras),
        "smallest": list(sizes[0]) if sizes else [0, 0],
        "largest": list(sizes[-1]) if sizes else [0, 0],
        "skipped": {
            reason: {"count": len(names), "first": list(names[:FIRST_NAMES])}
            for reason, names in scene.skipped.items()
        },
        "points": len(scene.points),
        "stray_points": scene.stray_points,
        "observations": sum(len(image.point_indices) for image in scene.images),
        "has_tracks": scene.has_tracks,
        "extent": scene.extent(),
        "bounds": bounds.tolist(),
        "rois": boxes,
        "warnings": warnings,
    }


def inspect_roi(scene: SfmScene, roi: OrientedBox) -> dict[str, Any]:
    """One box's figures.

    Keys: `name`; `sides` (3 lengths, world units); `points` (inside); `photos` (that see the box,
    by selection's rule: `model.visibility`); `median_area` (median over these photos of the share
    of the image that the silhouette covers, 0 to 1); `nearest`, `farthest` (distance of these
    photos' cameras from the box's centre, world units; 0 if there are none); `cameras_inside`
    (number of these photos inside the box). `inspect --check-photos` adds `faults`
    (`guidance.faults`), which need decoded photos.
    """
    seen = observations(scene, roi)
    photos = seen.images
    areas = [roi.projected_area(image.camera, image.world_to_camera) for image in photos]
    distances = [float(np.linalg.norm(image.centre - roi.centre)) for image in photos]
    return {
        "name": roi.name,
        "sides": (2 * roi.half_extents).tolist(),
        "points": len(seen.points),
        "photos": len(photos),
        "median_area": float(np.median(areas)) if areas else 0.0,
        "nearest": min(distances, default=0.0),
        "farthest": max(distances, default=0.0),
        "cameras_inside": sum(roi.camera_inside(image.world_to_camera) for image in photos),
    }


def format_inspection(record: dict[str, Any]) -> str:
    """The result of `inspect_scene` as text."""
    sizes = [" x ".join(map(str, record[key])) for key in ("smallest", "largest")]
    size = " to ".join(dict.fromkeys(sizes)) + " pixels"
    lines = [
        f"photos   {record['photos']}, {counted(record['cameras'], 'camera')}, {size}",
        f"points   {record['points']}, seen {record['observations']} times"
        + (f", {record['stray_points']} left out, far from all" if record["stray_points"] else ""),
        f"extent   {record['extent']:.4g} scene units",
    ]
    if not record["has_tracks"]:
        lines.append("tracks   none: the model does not store which photo sees which point")
    for reason, entry in record["skipped"].items():
        more = ", …" if entry["count"] > len(entry["first"]) else ""
        lines.append(f"skipped  {entry['count']} {reason}: {', '.join(entry['first'])}{more}")
    for roi in record["rois"]:
        sides = " x ".join(f"{side:.4g}" for side in roi["sides"])
        lines.append(f"Box '{roi['name']}', {sides}")
        seen = (
            f", covering {100 * roi['median_area']:.1f} % of one (median), from"
            f" {roi['nearest']:.4g} to {roi['farthest']:.4g} away"
        )
        lines.append(
            f"         {counted(roi['points'], 'point')} inside, seen on "
            f"{counted(roi['photos'], 'photo')}{seen if roi['photos'] else ''}"
        )
        if roi["cameras_inside"]:
            lines.append(f"         {counted(roi['cameras_inside'], 'camera')} inside the box")
        for fault in roi.get("faults", ()):
            lines.append(f"         check {fault['photo']}: {fault['text']}")
    lines += [f"warning: {text}" for text in record["warnings"]]
    return "\n".join(map(printable, lines))
