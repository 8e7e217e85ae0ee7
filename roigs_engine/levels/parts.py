"""The parts of a result (each box, and the surroundings), drawn small for their levels.

With one sample per pixel, a small picture widens each Gaussian to at least a pixel. Thin Gaussians
grow, and dense ones cover those behind them. So a level learns from pictures that are drawn with
several samples per pixel, averaged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..context import QUIET, Context
from ..errors import RunFolderError
from ..formats import run_files
from ..formats.files import matching, read_json
from ..formats.levels import rate_in_view, read_ladders, shown_levels
from ..model.gaussians import Gaussians
from ..model.local_frame import LocalFrame
from ..model.operations import faded
from ..model.scene import Camera, Float64, PosedImage
from ..rasterize.view import View, render_view

PROBES = 256
FARTHEST = 1e9  # limit of a probe's coordinates, units of the frame
LEAST_WEIGHT = -80.0  # logarithm of a Gaussian's least weight when probes are chosen
CAPTURE = 0.75
"""A part's rate is this quantile of its photos' rates: near photos have detail that others lack."""
MARGIN = 0.06  # margin around the part in a picture, as a share of its size
SMALLEST = 12  # pixels; smaller pictures of a part teach little
BLACK, WHITE = 0.0, 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """A part of a result."""

    box: str  # name of the box; empty: the surroundings
    ply: str  # the file with all its Gaussians, relative to the run folder
    gaussians: Gaussians  # in the frame
    probes: Float64  # (P, 3) points in the frame that represent the part
    rate: float  # resolution of its photos, pixels per unit of the frame; 0: no photo shows it


def parts_of_run(folder: Path, images: Sequence[PosedImage], frame: LocalFrame) -> list[Part]:
    """Read the parts of a run's result, without empty ones; `images` are in the frame.

    RunFolderError: there is no result, or a file is damaged.
    """
    files = {"": folder / run_files.BACKGROUND}
    boxes: set[str] | None = None  # unknown
    with suppress(RunFolderError, KeyError, TypeError):
        boxes = {str(roi["name"]) for roi in read_json(folder / run_files.MANIFEST)["rois"]}
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
        # Without `photo_focal`, each picture is drawn for its own pixel size.
        gaussians = replace(Gaussians.load_ply(path, frame), photo_focal=None)
        probes = _probes(gaussians) if len(gaussians) else np.zeros((0, 3))
        if not len(probes):
            continue
        rates = [rate_of(probes, (image.camera, image.world_to_camera)) for image in images]
        seen = [rate for rate in rates if rate > 0]
        rate = float(np.quantile(seen, CAPTURE)) if seen else 0.0
        ply = path.relative_to(folder).as_posix()
        parts.append(Part(box=box, ply=ply, gaussians=gaussians, probes=probes, rate=rate))
    return parts


def rate_of(probes: Float64, view: View) -> float:
    """Resolution of the probes in a view, see `formats.levels.rate_in_view`."""
    camera, pose = view
    return rate_in_view(probes, clip_matrix(camera) @ pose, camera.fx)


def clip_matrix(camera: Camera) -> Float64:
    """(4, 4) from the camera's frame to clip space; w is the depth."""
    c, matrix = camera, np.zeros((4, 4))
    matrix[0, 0], matrix[0, 2] = 2 * c.fx / c.width, 2 * c.cx / c.width - 1
    matrix[1, 1], matrix[1, 2] = 2 * c.fy / c.height, 2 * c.cy / c.height - 1
    matrix[2, 2] = matrix[3, 2] = 1.0
    return matrix


def _probes(gaussians: Gaussians) -> Float64:
    """(P, 3) centres of random Gaussians; large and opaque ones, which fill more, are likelier."""
    areas = torch.topk(gaussians.log_scales.double(), 2, dim=1).values.sum(dim=1)
    opacities = torch.nn.functional.logsigmoid(gaussians.logit_opacities.double())
    logs = (areas + opacities).numpy()  # the weights themselves could underflow or overflow
    means: Float64 = gaussians.means.numpy().astype(np.float64)
    good = np.isfinite(logs) & (np.abs(means) < FARTHEST).all(axis=1)
    logs, means = logs[good], means[good]
    if not len(means):
        return means
    weights = np.exp(np.clip(logs - np.quantile(logs, 0.99), LEAST_WEIGHT, 0.0))
    shares, count = weights / weights.sum(), min(PROBES, len(weights))
    chosen = np.random.default_rng(0).choice(len(shares), count, replace=False, p=shares)
    return np.asarray(means[np.sort(chosen)])


def views_at(part: Part, views: Sequence[View], coarser: float) -> list[View]:
    """Resize views so that they show the part `coarser` times as coarsely as its photos.

    Each view is cropped to the part. Views that already show it more coarsely, or hardly show it,
    are left out.
    """
    found = []
    for camera, pose in views:
        rate = rate_of(part.probes, (camera, pose))
        factor = part.rate / (coarser * rate) if rate > 0 else math.inf
        if factor > 1 + 1e-6:
            continue
        cropped = _cropped(camera, _window(part, camera, pose), factor)
        if min(cropped.width, cropped.height) >= SMALLEST:
            found.append((cropped, pose))
    return found


def small_picture(gaussians: Gaussians, view: View, samples: int, background: float) -> Tensor:
    """Render a model to (H, W, 3), with `samples` x `samples` samples per pixel of the view."""
    camera, pose = view
    large = camera.resized(camera.width * samples, camera.height * samples)
    colour = gaussians.means.new_full((3,), background)
    image = render_view(gaussians, large, pose, background=colour).image
    return image.reshape(camera.height, samples, camera.width, samples, 3).mean(dim=(1, 3))


def samples_for(coarser: float) -> int:
    """Samples per pixel and axis, so that a part is sampled at least as finely as by its photos."""
    return max(1, math.ceil(coarser - 1e-6))


class TeacherPictures:
    """Pictures of a part that serve as the trainer's photos; rendered once, kept as bytes."""

    def __init__(
        self,
        part: Part,
        views: Sequence[View],
        backgrounds: Sequence[float],
        coarser: float,
        context: Context = QUIET,
    ) -> None:
        """Args: `views`: from `views_at` with `coarser`; `backgrounds`: grey behind each view."""
        device = torch.device(context.device)
        model, samples = part.gaussians.to(device), samples_for(coarser)
        self._pictures = []
        for view, background in zip(views, backgrounds, strict=True):
            context.check_cancelled()
            image = small_picture(model, view, samples, background)
            self._pictures.append((255 * image).round().to(torch.uint8).cpu().numpy())

    def __getitem__(self, index: int) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
        return self._pictures[index]

    def prefetch(self, indices: Sequence[int]) -> None:
        """Do nothing: all pictures are in memory."""


def _window(part: Part, camera: Camera, pose: Float64) -> tuple[float, float, float, float]:
    """x0, y0, x1, y1: the rectangle with nearly all of the part's centres, and a margin, pixels."""
    local = part.gaussians.means.double().numpy() @ pose[:3, :3].T + pose[:3, 3]
    local = local[local[:, 2] > 0]
    x = camera.fx * local[:, 0] / local[:, 2] + camera.cx
    y = camera.fy * local[:, 1] / local[:, 2] + camera.cy
    shown = (x >= 0) & (x <= camera.width) & (y >= 0) & (y <= camera.height)
    if not shown.any():
        return 0.0, 0.0, 0.0, 0.0
    (x0, x1), (y0, y1) = (np.quantile(v[shown], (0.005, 0.995)) for v in (x, y))
    wide, high = MARGIN * (x1 - x0) + 2, MARGIN * (y1 - y0) + 2
    return (
        max(0.0, x0 - wide),
        max(0.0, y0 - high),
        min(float(camera.width), x1 + wide),
        min(float(camera.height), y1 + high),
    )


def _cropped(camera: Camera, window: tuple[float, float, float, float], factor: float) -> Camera:
    """The camera for a window, scaled by `factor`."""
    x0, y0, x1, y1 = window
    return Camera(
        width=int(factor * (x1 - x0)),
        height=int(factor * (y1 - y0)),
        fx=factor * camera.fx,
        fy=factor * camera.fy,
        cx=factor * (camera.cx - x0),
        cy=factor * (camera.cy - y0),
    )


class LevelledResult:
    """The result of a run, with each part in the level that a view needs.

    Files are read when they are first needed, and kept in memory. `quality` is as in
    `shown_levels`. RunFolderError: there are no levels, or a file is damaged.
    """

    def __init__(
        self,
        folder: Path,
        frame: LocalFrame,
        *,
        quality: float = 1.0,
        device: torch.device | None = None,
    ) -> None:
        self._folder, self._frame, self._quality = folder, frame, quality
        self._device = device or torch.device("cpu")
        self._ladders = [
            replace(ladder, probes=frame.points(ladder.probes), rate=ladder.rate / frame.scale)
            for ladder in read_ladders(folder).values()
        ]
        self._read: dict[str, Gaussians] = {}

    def gaussians(self, camera: Camera, world_to_camera: Float64) -> Gaussians:
        """The Gaussians for a view, in the frame."""
        parts = []
        for ladder in self._ladders:
            rate = rate_of(ladder.probes, (camera, world_to_camera))
            for level, density in shown_levels(ladder, rate, self._quality):
                part = self._part(level.ply)
                logits = faded(part.logit_opacities, density)
                parts.append(replace(part, logit_opacities=logits))
        return Gaussians.concatenate(parts)

    def _part(self, ply: str) -> Gaussians:
        if ply not in self._read:
            read = Gaussians.load_ply(self._folder / ply, self._frame)
            self._read[ply] = read.to(self._device)
        return self._read[ply]
