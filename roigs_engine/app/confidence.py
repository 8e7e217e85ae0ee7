"""Measures how well a run's photos cover each Gaussian of its result, or of another model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats.confidence import COLUMNS, colours, most_directions
from ..formats.files import atomic_write, refuse_linked_folders
from ..formats.lock import locked
from ..formats.run_files import RESULT
from ..formats.splat_ply import check_ply
from ..formats.text import counted
from ..requests.runs import Confidence
from .asked import Asked
from .instances import as_one, listed_models
from .outputs import Result, refuse_inputs, refuse_run_files

if TYPE_CHECKING:
    from ..evaluation.confidence import Float32
    from ..model.gaussians import Gaussians

PLY, NUMPY = ".ply", ".npy"


def find_confidence(request: Confidence, context: Context = QUIET) -> Result:
    """Measure how well a run's photos cover each Gaussian; EngineError for unusable input.

    The training photos give the directions from which it is seen, the test photos its error.
    """
    suffix = request.out.suffix.lower()
    if suffix not in (PLY, NUMPY):
        raise ConfigError(
            f"--out {request.out} is neither a PLY nor a NumPy file.", "Write FILE.ply or FILE.npy."
        )
    if request.heat_map and suffix != PLY:
        raise ConfigError("--heat-map colours a PLY.", "Write --out FILE.ply.")
    refuse_run_files(request.out)
    asked = Asked.of_run(request.run, request.scene, device=request.device, threads=request.threads)
    model = request.model or request.run / RESULT
    wanted = listed_models(model)
    files = [Path(item.file) for item in wanted]
    refuse_inputs([request.out], [model, *files])
    for path in files:
        check_ply(path)

    import torch

    from ..evaluation.confidence import confidence

    with locked(request.run, context.warn, option=None):
        refuse_linked_folders(request.run)
        run, context = asked.trained(context)
        gaussians, there = as_one(wanted, run.frame, context)
        gaussians = gaussians.to(torch.device(context.device))
        images = run.train_scene.images
        found = confidence(gaussians, images, run.test_scene.images, context)
        if suffix == PLY:
            shown = _heated(gaussians, found.directions) if request.heat_map else gaussians
            shown.save_ply(request.out, run.frame, found.columns)
        else:
            table = np.full((len(there), len(COLUMNS)), np.nan, np.float32)
            table[there] = np.stack([*found.columns.values()], axis=1)
            with atomic_write(request.out) as file:
                np.save(file, table)
    few = int((found.directions < 3).sum())
    text = (
        f"{counted(len(gaussians), 'Gaussian')}, {few:,} of them seen from fewer than 3"
        f" directions: {request.out}"
    )
    return Result(files={"confidence": request.out}, text=text)


def _heated(gaussians: Gaussians, directions: Float32) -> Gaussians:
    """Return the Gaussians in the colours of a heat map, the same from all sides."""
    import torch

    from ..model.gaussians import SH_C0

    sh = (colours(directions, most_directions(directions)) - 0.5) / SH_C0
    return replace(gaussians, sh=torch.from_numpy(sh[:, None]).to(gaussians.means))
