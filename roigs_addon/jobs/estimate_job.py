"""Estimating: the engine trains a few steps and estimates the training time."""

from __future__ import annotations

import re
from collections.abc import Mapping

import bpy

from ..engine import own_files
from ..errors import AddonError
from ..properties import scene_props
from ..scene import lookup, rois
from . import options_files, run_folders
from .last_said import last_said
from .spec import ESTIMATING, JobSpec

TIME = re.compile(r"(?:\S+ +)?Time: (.+?)\.?")
"""Line of the engine's plan with the estimated time, after the log's time of day."""

_known: dict[tuple[object, ...], str] = {}


def spec(scene: bpy.types.Scene) -> JobSpec:
    """Return the job that estimates the time of a training of all boxes.

    Raises:
        AddonError: something is missing, or the run folder cannot be written to.
    """
    options = options_files.write_train_options(scene, lookup.rois(scene), 0.0)
    folder, key = run_folders.run_folder(scene), _key(scene)
    log = own_files.log_file(folder)

    def take(_: Mapping[str, str]) -> None:
        _known.clear()
        _known[key] = last_said(log, TIME)

    return JobSpec(
        title=ESTIMATING,
        arguments=["train", str(options), "--run-dir", str(folder), "--dry-run"],
        log=log,
        then=take,
    )


def known(scene: bpy.types.Scene) -> str:
    """Return, say, 'about 4 minutes on this machine (2 threads)'; empty without an estimate.

    An estimate counts only for the settings and boxes that it was made for.
    """
    return _known.get(_key(scene), "")


def forget() -> None:
    """Forget the estimate, for tests and when the add-on is unregistered."""
    _known.clear()


def _key(scene: bpy.types.Scene) -> tuple[object, ...]:
    """Return a key of everything that the time depends on."""
    props = scene_props(scene)
    settings = (props.colmap, props.preset, props.strategy, props.steps_factor, props.max_side)
    return (
        *settings,
        props.test_every,
        len(props.excluded),
        *(_place(roi, scene) for roi in lookup.rois(scene)),
    )


def _place(roi: bpy.types.Object, scene: bpy.types.Scene) -> str:
    try:
        return rois.place_key(roi, scene)
    except AddonError:
        return roi.name
