"""Estimates the disk space of a run before it starts."""

from __future__ import annotations

from ..colmap.undistortion_cache import PER_PIXEL, missing_in
from ..formats.events import Message
from ..formats.run_files import CACHE
from ..machine import disk_message
from .definition import Run
from .forecast import Forecast

PER_GAUSSIAN = 62 * 4  # bytes in a PLY with SH of degree 3
PER_STATE = 4 * 62 * 4  # in a checkpoint: parameters, two moments, the mean of models
CHECKPOINTS = 3  # the last one, the one before, and the one that is written
OUTPUTS = 4  # times a model: whole, without boxes, the boxes' Gaussians, a preview


def disk_space(run: Run, expected: Forecast) -> Message:
    """What the run will write at most; a warning if less is free."""
    missing = [stage.whole for stage in expected.stages if not stage.is_done]
    distorted = missing_in(run.folder / CACHE, run.scene.images)
    needed = PER_PIXEL * sum(image.camera.width * image.camera.height for image in distorted)
    if missing:
        ends = [stage.end for stage in missing]
        needed += PER_STATE * CHECKPOINTS * max(stage.most for stage in missing)
        needed += PER_GAUSSIAN * (sum(ends) + OUTPUTS * max(ends))
    return disk_message(needed, run.folder)
