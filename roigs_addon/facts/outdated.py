"""Tells what **Train** would train, by comparing the run folder with the scene; cached."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import bpy

from ..engine import run_settings
from ..engine.run_settings import BOX_SETTINGS, RunSettings
from ..engine.run_status import RunStatus
from ..jobs import options_files
from ..properties import object_props
from ..scene import lookup, rois
from ..shared import run_files
from . import photo_names, run_facts


def in_words(scene: bpy.types.Scene, status: RunStatus) -> str:
    """Describe changes since the training, and what **Train** will do; empty without changes."""
    names, then, now = _settings(scene, status)
    parts = []
    if names == ["recipe"]:
        parts.append("Trained by an earlier version with other preset settings")
    elif names:
        told = run_settings.in_words(then, names), run_settings.in_words(now, names)
        parts.append("Last training: {}. Now: {}".format(*told))
    if boxes := run_facts.changed_boxes(scene, status):
        parts.append(f"Changed since training: {', '.join(boxes)}")
    if lists := list(_changed_lists(scene, status)):
        parts.append(f"Photo list changed since training: {', '.join(lists)}")
    if not parts:
        return ""
    whole = any(name not in BOX_SETTINGS for name in names)
    if whole and names != ["recipe"] and _is_known(scene, now):
        return f"{'. '.join(parts)}. Train reuses the earlier result where it still fits"
    whole = whole or bool(then.test_every) or then.strategy != "joint"
    what = "Train starts again" if whole else "Train repeats the boxes"
    return f"{'. '.join(parts)}. {what}{_time(status, then, now, whole=whole)}"


def renamed(scene: bpy.types.Scene, status: RunStatus) -> dict[str, str]:
    """Return trained name -> present name, for boxes that were renamed."""
    names = rois.trained_names(scene, status.boxes or {})
    return {old: new for new, old in names.items() if old != new}


def _is_known(scene: bpy.types.Scene, now: RunSettings) -> bool:
    """Whether an earlier result has these settings."""
    known = (result.settings for result in run_facts.earlier(scene))
    return any(k.preset and not run_settings.differing(k, now) for k in known)


def _settings(
    scene: bpy.types.Scene, status: RunStatus
) -> tuple[list[str], RunSettings, RunSettings]:
    """Return the names of differing settings, the trained settings, and the present ones.

    Photo sizes above that of the photos themselves do not count as different.
    """
    then = status.settings
    now = options_files.settings_now(scene, photo_names.excluded(scene))
    if then.max_side is not None and now.max_side is not None and then.max_side != now.max_side:
        most = _largest(scene)
        then = replace(then, max_side=min(then.max_side, most))
        now = replace(now, max_side=min(now.max_side, most))
    return run_settings.differing(then, now), then, now


def _largest(scene: bpy.types.Scene) -> int:
    """Return the longest side of the scene's photos."""
    photos = (lookup.photo_record(camera) for camera in lookup.of_kind(scene, "CAMERA"))
    sides = [max(p.intrinsics.width, p.intrinsics.height) for p in photos if p is not None]
    return max(sides, default=1 << 20)


def _changed_lists(scene: bpy.types.Scene, status: RunStatus) -> Iterator[str]:
    """Yield the names of trained boxes whose list of photos has changed."""
    if status.photos is None:
        return
    names = rois.trained_names(scene, status.boxes or {})
    for roi in lookup.rois(scene):
        chosen = dict.fromkeys(item.name for item in object_props(roi).selection)
        used = [photo for photo in chosen if photo in status.photos]
        if roi.name in names and used != status.lists.get(names[roi.name], []):
            yield roi.name


def _time(status: RunStatus, then: RunSettings, now: RunSettings, *, whole: bool) -> str:
    """Return ' (about 12 min)', from the time of the last training; empty if unknown."""
    stages = status.seconds.items()
    seconds = sum(s for name, s in stages if whole or name != run_files.SCENE_STAGE)
    before, after = run_settings.work(then), run_settings.work(now)
    if not seconds or not before or after is None:
        return ""
    minutes = seconds * after / before / 60
    return f" (about {minutes:.0f} min)" if minutes >= 1 else " (less than a minute)"
