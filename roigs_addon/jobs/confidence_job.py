"""Finding confidence: the engine measures how well the run's photos cover each Gaussian."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender import scene_of
from ..engine import own_files
from . import options_files, run_folders
from .judged import Judged
from .spec import CONFIDENCE, JobSpec

Known = dict[bpy.types.Object, NDArray[np.float32]]

NAME = "roigs-confidence"
"""Prefix of file names in Blender's temporary folder."""


def spec(context: bpy.types.Context, take: Callable[[Known], str]) -> JobSpec:
    """Return the job that measures how well the run's photos cover visible Gaussians.

    Args:
        context: gives the scene and the objects.
        take: gets each object with its points' columns `confidence.COLUMNS`, NaN for points that
            are not drawn; returns a line for the user.

    Raises:
        AddonError: there are no Gaussians, or files cannot be written.
    """
    scene = scene_of(context)
    folder, find = run_folders.settle(scene), run_folders.finder(scene)
    judged = Judged.write(context, NAME)

    def done() -> str | None:
        now = find()
        return None if now is None else take(judged.rows(now, np.nan, "Find confidence again."))

    given = [f"--model={judged.listed}", f"--out={judged.out}"]
    options = [*options_files.moved_scene(scene, folder), *options_files.machine_options()]
    return JobSpec(
        title=CONFIDENCE,
        arguments=["confidence", str(folder), *given, *options],
        log=own_files.log_file(folder),
        on_done=done,
        words=options_files.MOVED,
    )
