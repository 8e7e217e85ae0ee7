"""Reads the Gaussians of files for a conversion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...context import Context
from ...errors import RoiError
from ...exchange import formats
from ...requests.models import Convert
from ..inputs import boxes_of
from ..outputs import refuse_inputs
from ..run_scene import cameras_of_result

if TYPE_CHECKING:
    from ...exchange.arrays import Arrays
    from ...formats.targets import Target
    from ...model.scene import Float64


def refuse_own_inputs(request: Convert, *read: Path) -> None:
    """Raise ConfigError if OUT is one of the files that the conversion reads."""
    refuse_inputs([request.out], read, "Choose another OUT.")


def read_model(
    path: Path, context: Context, *, plain: bool, scene: Path | None = None
) -> tuple[Arrays, Target]:
    """Read the Gaussians of a file, and their target.

    With `plain`, anti-aliased Gaussians are changed to look about right without anti-aliasing. This
    needs photos: those of `scene`, or of the run that made the file. Without, they stay unchanged.
    """
    from ...exchange.transform import without_antialiasing
    from ...model.gaussians import Gaussians

    target = context.interruptible(lambda: formats.target_of(path))
    arrays = read_arrays(path, context)
    photos = cameras_of_result(path, scene) if target.antialiased and plain else None
    if photos is None:
        return arrays, target
    model, frame = Gaussians.framed(arrays, target=target)
    made = without_antialiasing(model, frame.scene(photos).images)
    return {**arrays, "logit_opacities": made.logit_opacities.numpy()}, made.target


def read_arrays(path: Path, context: Context) -> Arrays:
    """Read the Gaussians of a file, for any target."""
    return context.interruptible(lambda: formats.read(path, context.check_cancelled))


def cropped(arrays: Arrays, request: Convert, home: Float64) -> Arrays:
    """Return the Gaussians in the boxes, or all without boxes; `home` maps to the boxes' frame."""
    rois = boxes_of(request, required=False)
    if not rois:
        return arrays
    with np.errstate(invalid="ignore"):  # NaN and Inf are in no box
        means = arrays["means"].astype(np.float64) @ home[:3, :3].T
    inside = np.any([roi.contains(means) for roi in rois], axis=0)
    if not inside.any():
        raise RoiError("The boxes hold no Gaussian.", "Are they from the same scene?")
    return {name: values[inside] for name, values in arrays.items()}


def shortened(arrays: Arrays, request: Convert) -> Arrays:
    """Return the model with at most the SH degree `--sh-degree`."""
    if request.sh_degree is None:
        return arrays
    return {**arrays, "sh": arrays["sh"][:, : (request.sh_degree + 1) ** 2]}
