"""The parts of a result, each with its own ladder of levels: a box, or the surroundings."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ..errors import RunFolderError
from ..formats import run_files
from ..formats.files import matching, read_json
from ..formats.levels import rate_in_view
from ..model.gaussians import Gaussians
from ..model.local_frame import LocalFrame
from ..model.scene import Camera, Float64, PosedImage
from ..rasterize.view import View

PROBES = 256
FARTHEST = 1e9  # of a probe, units of the frame
LEAST_WEIGHT = -80.0  # of a Gaussian among the probes, as a logarithm
CAPTURE = 0.75
"""A part's rate is this quantile of its photos' rates: nearer photos hold what the others lack."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """A part of a result.

    Attributes:
        box: its name; empty: the surroundings.
        ply: of all its Gaussians, relative to the run folder.
        gaussians: in the frame.
        probes: (P, 3) points in the frame that stand for it.
        rate: how finely its photos show it, pixels per unit of the frame; 0: none does.
    """

    box: str
    ply: str
    gaussians: Gaussians
    probes: Float64
    rate: float


def parts_of_run(folder: Path, images: Sequence[PosedImage], frame: LocalFrame) -> list[Part]:
    """The parts of a run's result that have Gaussians.

    Args:
        folder: of the run.
        images: its photos, in the frame.
        frame: to compute in.

    Raises:
        RunFolderError: there is no result, or a file is damaged.
    """
    files = {"": folder / run_files.BACKGROUND}
    boxes = _boxes(folder)
    files |= {
        path.stem: path
        for path in matching(folder / run_files.FINE, "*.ply")
        if boxes is None or path.stem in boxes
    }
    if not files[""].is_file():
        raise RunFolderError(f"{folder} has no result.", "Train first, or give a run folder.")
    if lost := sorted((boxes or set()) - set(files)):
        raise RunFolderError(
            f"{folder / run_files.FINE} has no {lost[0]}.ply.",
            "Give the command that trained the run again: it writes the file.",
        )
    parts = []
    for box, path in sorted(files.items()):
        gaussians = Gaussians.load_ply(path, frame)
        probes = _probes(gaussians) if len(gaussians) else np.zeros((0, 3))
        if not len(probes):
            continue
        rates = [rate_of(probes, (image.camera, image.world_to_camera)) for image in images]
        seen = [rate for rate in rates if rate > 0]
        rate = float(np.quantile(seen, CAPTURE)) if seen else 0.0
        ply = path.relative_to(folder).as_posix()
        parts.append(Part(box=box, ply=ply, gaussians=gaussians, probes=probes, rate=rate))
    return parts


def _boxes(folder: Path) -> set[str] | None:
    """The names of a run's boxes; None: not known."""
    with suppress(RunFolderError, KeyError, TypeError):
        return {str(roi["name"]) for roi in read_json(folder / run_files.MANIFEST)["rois"]}
    return None


def rate_of(probes: Float64, view: View) -> float:
    """How finely a view shows the probes, see `formats.levels.rate_in_view`."""
    camera, pose = view
    return rate_in_view(probes, clip_matrix(camera) @ pose, camera.fx)


def clip_matrix(camera: Camera) -> Float64:
    """(4, 4) from the camera's frame to clip space, with w the depth."""
    c, matrix = camera, np.zeros((4, 4))
    matrix[0, 0], matrix[0, 2] = 2 * c.fx / c.width, 2 * c.cx / c.width - 1
    matrix[1, 1], matrix[1, 2] = 2 * c.fy / c.height, 2 * c.cy / c.height - 1
    matrix[2, 2] = matrix[3, 2] = 1.0
    return matrix


def _probes(gaussians: Gaussians) -> Float64:
    """Some of its Gaussians, large and opaque ones more likely: they fill more of a picture."""
    areas = torch.topk(gaussians.log_scales.double(), 2, dim=1).values.sum(dim=1)
    opacities = torch.nn.functional.logsigmoid(gaussians.logit_opacities.double())
    logs = (areas + opacities).numpy()  # the weights themselves may be 0 or no numbers
    means: Float64 = gaussians.means.numpy().astype(np.float64)
    good = np.isfinite(logs) & (np.abs(means) < FARTHEST).all(axis=1)
    logs, means = logs[good], means[good]
    if not len(means):
        return means
    weights = np.exp(np.clip(logs - np.quantile(logs, 0.99), LEAST_WEIGHT, 0.0))
    shares, count = weights / weights.sum(), min(PROBES, len(weights))
    chosen = np.random.default_rng(0).choice(len(shares), count, replace=False, p=shares)
    found: Float64 = means[np.sort(chosen)]
    return found
