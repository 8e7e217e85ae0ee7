"""Makes the levels of a run's result: trains, measures, and writes them with `levels.json`.

docs/method.md, "Levels of detail", describes the training of a level, and where it begins.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..context import QUIET, Context
from ..cuda.device import CPU
from ..errors import RunFolderError, SceneError
from ..evaluation.metrics import psnr_from_mse
from ..formats import run_files
from ..formats.files import own_file, read_record, remove_leftovers, sha256, write_json
from ..formats.levels import FADE, Ladder, Level, write_ladders
from ..formats.lock import check_held
from ..formats.splat_ply import photo_focal_of
from ..formats.text import json_digest
from ..model.gaussians import Gaussians
from ..model.local_frame import LocalFrame
from ..model.scene import PosedImage
from ..photos.headers import content_digest
from ..rasterize.limits import PICTURE_LIMITS
from ..rasterize.view import View, blending_weights
from ..training.config import TrainConfig
from ..training.floaters import poses_between
from ..training.mechanisms.model_averaging import ModelAveraging
from ..training.photo_order import shuffled
from ..training.stage_data import StageData
from ..training.trainer import Trainer
from .parts import (
    BLACK,
    WHITE,
    Part,
    TeacherPictures,
    parts_of_run,
    samples_for,
    small_picture,
    views_at,
)

LEVELS = 5  # including the whole part
HELD = 8  # one view in this many is held out of training, to measure
FEW = 16  # with fewer photos, training uses all, and views between them are held out
MOST_BETWEEN = 60
STEPS = 500
SHARE = 0.5  # if a Gaussian is in fewer of the views on average, a part trains for longer
LONGEST = 4.0  # times as long at most
FAINTEST = 1 / 255  # least blending weight with which a view shows a Gaussian
LEAST = 64  # Gaussians of a level
GREY = 0.5
STEP = 2 ** (1 / 3)  # ratio of two measured distances
NEAREST, FARTHEST = STEP, 8.0
APART = FADE**2
"""Least ratio of the distances at which two levels begin, so that their fades do not overlap."""
ENOUGH = 40.0  # dB; an RMS error of 2.5 of 255


@dataclass(frozen=True, kw_only=True, eq=False)
class Views:
    """The views for training, and the views held out to measure."""

    train: list[View]
    held: list[View]


def make_levels(
    folder: Path,
    images: Sequence[PosedImage],
    frame: LocalFrame,
    *,
    levels: int = LEVELS,
    steps: int = STEPS,
    context: Context = QUIET,
) -> list[Ladder]:
    """Make the levels of a run's result; existing valid ones are kept.

    Args:
        folder: the run folder, locked.
        images: the run's photos, in the frame; only their cameras are used.
        levels: number of levels, including the whole result.
        steps: training steps for each level.

    Raises:
        RunFolderError: there is no result, or it is damaged.
        SceneError: no photo shows a part.
        Stopped: on request; the same call resumes later.
    """
    remove_leftovers(folder)
    parts = parts_of_run(folder, images, frame)
    if not any(part.rate for part in parts):
        raise SceneError("No photo shows the result.", "Give its training scene (--scene).")
    maker = _Maker(folder, frame, training_views(images), steps, context)
    ladders = [maker.ladder(part, levels) for part in parts]
    check_held(folder)
    write_ladders(folder, ladders)
    return ladders


def training_views(images: Sequence[PosedImage]) -> Views:
    """The photos' cameras, and views between them; some are held out."""
    few = len(images) < FEW
    held = [] if few else list(images[HELD // 2 :: HELD])
    trained = [image for image in images if image not in held]
    between = [(trained[near[0]].camera, pose) for near, pose in poses_between(trained)]
    between = between[:: -(-len(between) // MOST_BETWEEN) or 1]
    cameras = [(image.camera, image.world_to_camera) for image in trained]
    if few:
        return Views(train=[*cameras, *between[1::2]], held=between[::2] or cameras)
    kept_back = [(image.camera, image.world_to_camera) for image in held]
    return Views(train=[*cameras, *between], held=kept_back)


@dataclass(frozen=True)
class _Maker:
    """Makes the levels of the parts, one part at a time."""

    folder: Path
    frame: LocalFrame
    views: Views
    steps: int
    context: Context

    def ladder(self, part: Part, levels: int) -> Ladder:
        """The ladder of a part, with at most `levels` levels; trains missing ones."""
        made: dict[str, Gaussians] = {}
        start: Gaussians | None = part.gaussians
        for level in range(1, levels):
            if start is None or len(part.gaussians) < LEAST << level:
                break
            ply = f"{run_files.LEVELS}/{level}/{part.ply}"
            start = self._level(part, ply, start, level)
            if start is not None:
                made[ply] = start
        records = measure(part, list(made.values()), self.views.held, self.context)
        firsts = {ply: farther(measured) for ply, measured in zip(made, records, strict=True)}
        good = {ply: first for ply, first in firsts.items() if first is not None}
        rungs = [Level(ply=part.ply, gaussians=len(part.gaussians), farther=0.0, measured={})]
        begins = spaced([first.coarser for first in good.values()])
        for (ply, first), begin in zip(good.items(), begins, strict=True):
            psnrs = {"psnr": first.level, "psnr_whole": first.whole, "psnr_to_whole": first.between}
            count = len(made[ply])
            rungs.append(Level(ply=ply, gaussians=count, farther=begin, measured=psnrs))
        return Ladder(
            box=part.box,
            rate=(part.rate or 1.0) * self.frame.scale,  # a part that no photo shows has one level
            probes=part.probes / self.frame.scale + self.frame.origin,
            levels=tuple(rungs),
        )

    def _level(self, part: Part, ply: str, start: Gaussians, level: int) -> Gaussians | None:
        """A level's Gaussians: read if made from the same inputs, else trained and written."""
        record = self.folder / run_files.LEVELS / run_files.LEVELS_MADE
        inputs = {
            "whole": content_digest(self.folder / part.ply),
            "views": [
                [camera.matrix().tolist(), pose.tolist()] for camera, pose in self.views.train
            ],
            "level": level,
            "steps": self.steps,
        }
        digest = json_digest(inputs)
        path = own_file(self.folder, ply)
        with suppress(RunFolderError, OSError):  # missing or damaged
            if read_record(record).get(ply) == [digest, sha256(path)]:
                return replace(Gaussians.load_ply(path, self.frame), photo_focal=None)
        made = make_level(
            part, start, self.views.train, level, steps=self.steps, context=self.context
        )
        if made is None:
            return None
        check_held(self.folder)
        focal = photo_focal_of(self.folder / part.ply)
        replace(made, photo_focal=focal).save_ply(path, self.frame)
        write_json(record, read_record(record) | {ply: [digest, sha256(path)]})
        return replace(Gaussians.load_ply(path, self.frame), photo_focal=None)


def coarseness(level: int) -> float:
    """How many times coarser than the photos the training views of level `level` are.

    Each level has half the Gaussians of the one before, for 4^(1/3) times its distance. So an
    eighth of the Gaussians serves 4 times the distance.
    """
    return float(4 ** (level / 3))


def make_level(
    part: Part,
    start: Gaussians,
    views: list[View],
    level: int,
    *,
    steps: int = STEPS,
    context: Context = QUIET,
) -> Gaussians | None:
    """Train a level of a part, from 1; None if stopped, or no view can show the part so coarsely.

    It starts from the level before, or the whole part. `steps` is for parts whose Gaussians are
    each in `SHARE` of the views; if they are in fewer, it trains for longer.
    """
    coarser = coarseness(level)
    small = views_at(part, views, coarser)
    if not small:
        return None
    weights, share = contributions(start, small, context)
    steps = round(steps * min(max(SHARE / max(share, 1e-6), 1.0), LONGEST))
    count = max(LEAST, len(part.gaussians) >> level)
    kept = weights.topk(min(count, len(start))).indices.sort().values
    device = torch.device(context.device)
    backgrounds = [(BLACK, WHITE)[k % 2] for k in range(len(small))]
    config = TrainConfig(
        steps=steps,
        sh_degree=int(np.sqrt(start.sh.shape[1])) - 1,
        sh_start=3,
        lr_shN=1.25e-3,
        lr_scales=0.01,
        made_for=start.target.name,
        mechanisms=(ModelAveraging(steps=steps // 5),),
    )
    data = StageData(
        images=[_image(view, k) for k, view in enumerate(small)],
        photos=TeacherPictures(part, small, backgrounds, coarser, context),
        photo_at=shuffled(range(len(small)), 0),
        # The part's radius, for the learning rate of positions.
        extent=float(np.linalg.norm(part.probes - part.probes.mean(axis=0), axis=1).max()),
        backgrounds=torch.tensor(backgrounds, device=device)[:, None].expand(-1, 3),
        device=device,
    )
    trainer = Trainer(start.rows(kept), data, config)
    name = f"level {level} of {part.box or 'surroundings'}"
    if not trainer.run(context, stage=name):
        context.check_cancelled()
        return None
    return trainer.gaussians.detached().to(CPU)


@torch.no_grad()
def contributions(
    gaussians: Gaussians, views: list[View], context: Context = QUIET
) -> tuple[Tensor, float]:
    """(N,) contribution of each Gaussian to the views, on the CPU; the mean share of views.

    The contribution is the largest blending weight times the root of the sum of weights. So a
    Gaussian counts if it is bright in one view, and if it fills many. The share is that of the
    views that show a Gaussian, averaged over the Gaussians.
    """
    model = gaussians.to(torch.device(context.device))
    most, total, shown = (model.means.new_zeros(len(model)) for _ in range(3))
    for weights in blending_weights(model, views, context, limits=PICTURE_LIMITS):
        most, total = torch.maximum(most, weights.largest), total + weights.total
        shown += weights.largest > FAINTEST
    return (most * total.sqrt()).cpu(), float(shown.mean()) / max(len(views), 1)


def _image(view: View, number: int) -> PosedImage:
    camera, pose = view
    return PosedImage(
        name=f"view {number}",
        path=Path(),  # there is no file: its pixels are rendered
        camera=camera,
        world_to_camera=pose,
    )


@dataclass(frozen=True, kw_only=True)
class Measured:
    """PSNRs of a level at a distance, dB, mean over views."""

    coarser: float  # how many times coarser than the photos, see `formats.levels`
    whole: float  # the whole part as viewers draw it, against the truth
    level: float  # the level against the truth
    between: float  # the level against the whole part as viewers draw it


def distances() -> list[float]:
    """The measured distances, as multiples of the photos' distance."""
    count = round(math.log(FARTHEST / NEAREST, STEP)) + 1
    return [NEAREST * STEP**k for k in range(count)]


@torch.no_grad()
def measure(
    part: Part, levels: Sequence[Gaussians], views: Sequence[View], context: Context = QUIET
) -> list[list[Measured]]:
    """Measure each level at each distance that the views can show."""
    device = torch.device(context.device)
    whole, models = part.gaussians.to(device), [level.to(device) for level in levels]
    found: list[list[Measured]] = [[] for _ in levels]
    for coarser in distances():
        small = views_at(part, views, coarser)
        rows = []
        for view in small:
            context.check_cancelled()
            truth = small_picture(whole, view, samples_for(coarser), GREY)
            plain = small_picture(whole, view, 1, GREY)
            drawn = [small_picture(model, view, 1, GREY) for model in models]
            errors = [[_error(picture, truth), _error(picture, plain)] for picture in drawn]
            rows.append([_error(plain, truth), *np.ravel(errors)])
        if not rows:
            continue
        plain_error, *others = (psnr_from_mse(float(mean)) for mean in np.mean(rows, axis=0))
        for k, records in enumerate(found):
            level, between = others[2 * k : 2 * k + 2]
            records.append(
                Measured(coarser=coarser, whole=plain_error, level=level, between=between)
            )
    return found


def farther(records: Sequence[Measured]) -> Measured | None:
    """The least distance from which a level is always good enough; None: there is none."""
    good: Measured | None = None
    for record in reversed(records):
        if record.level < min(record.whole, ENOUGH):
            break
        good = record
    return good


def spaced(steps: Sequence[float]) -> list[float]:
    """Increase distances where levels begin to at least `APART` times the one before."""
    return list(accumulate(steps, lambda before, step: max(step, APART * before)))


def _error(picture: torch.Tensor, truth: torch.Tensor) -> float:
    return float(((picture - truth) ** 2).double().mean())
