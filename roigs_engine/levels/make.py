"""Makes the levels of a run's result: trains, measures, and writes `levels.json`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..context import QUIET, Context
from ..errors import RunFolderError, SceneError
from ..formats import run_files
from ..formats.files import own_folder, read_json, remove_leftovers, write_json
from ..formats.levels import Ladder, Level, write_ladders
from ..formats.lock import check_held
from ..formats.text import json_digest
from ..model.gaussians import Gaussians
from ..model.local_frame import LocalFrame
from ..model.scene import PosedImage
from ..photos.headers import content_digest
from ..rasterize.view import View
from ..training.floaters.between_views import poses_between
from .ladder import LEAST, STEPS, make_level
from .measure import farther, measure, spaced
from .parts import Part, parts_of_run

LEVELS = 5
"""How many, with the whole one."""
HELD = 8
"""One view in `HELD` is measured on and not trained on."""
FEW = 16
"""With fewer photos, all are trained on, and measured on are views between them."""
MOST_BETWEEN = 60


@dataclass(frozen=True, kw_only=True, eq=False)
class Views:
    """The views to train on, and those to measure on."""

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
    """Make the levels of a run's result; levels that are there and fit are kept.

    Args:
        folder: of the run, locked.
        images: its photos, of which only the cameras are used, in the frame.
        frame: to compute in.
        levels: how many, with the whole one.
        steps: to train each for.
        context: gives the device; receives progress.

    Raises:
        RunFolderError: there is no result, or it is damaged.
        SceneError: no photo shows a part.
        Stopped: on request; the same call goes on later.
    """
    remove_leftovers(folder)
    parts = parts_of_run(folder, images, frame)
    if not any(part.rate for part in parts):
        raise SceneError(
            "No photo shows the result.", "Give the scene that it was trained on (--scene)."
        )
    maker = _Maker(folder, frame, training_views(images), steps, context)
    ladders = [maker.ladder(part, levels) for part in parts]
    check_held(folder)
    write_ladders(folder, ladders, {})
    return ladders


def training_views(images: Sequence[PosedImage]) -> Views:
    """The photos' cameras and views between them, some of the photos' held back."""
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
    """Makes the levels of one part after the other."""

    folder: Path
    frame: LocalFrame
    views: Views
    steps: int
    context: Context

    def ladder(self, part: Part, levels: int) -> Ladder:
        """The ladder of a part, with at most `levels` levels; trains what is not there."""
        made: list[tuple[str, Gaussians]] = []
        start = part.gaussians
        for level in range(1, levels):
            if len(part.gaussians) < LEAST << level:
                break
            ply = f"{run_files.LEVELS}/{level}/{part.ply}"
            found = self._level(part, ply, start, level)
            if found is None:
                break
            made.append((ply, found))
            start = found
        records = measure(part, [model for _, model in made], self.views.held, self.context)
        good = [
            (ply, model, first)
            for (ply, model), measured in zip(made, records, strict=True)
            if (first := farther(measured)) is not None
        ]
        begins = spaced([first.coarser for _, _, first in good])
        whole = Level(ply=part.ply, gaussians=len(part.gaussians), farther=0.0, measured={})
        coarser = tuple(
            Level(
                ply=ply,
                gaussians=len(model),
                farther=begin,
                measured={
                    "psnr": first.level,
                    "psnr_whole": first.whole,
                    "psnr_to_whole": first.between,
                },
            )
            for (ply, model, first), begin in zip(good, begins, strict=True)
        )
        return Ladder(
            box=part.box,
            rate=(part.rate or 1.0) * self.frame.scale,  # without a photo, it has one level
            probes=part.probes / self.frame.scale + self.frame.origin,
            levels=(whole, *coarser),
        )

    def _level(self, part: Part, ply: str, start: Gaussians, level: int) -> Gaussians | None:
        """A level's Gaussians: read if they were made from the same, else trained and written."""
        record = self.folder / run_files.LEVELS / run_files.LEVELS_MADE
        digest = json_digest(
            {
                "whole": content_digest(self.folder / part.ply),
                "views": [
                    [camera.matrix().tolist(), pose.tolist()] for camera, pose in self.views.train
                ],
                "level": level,
                "steps": self.steps,
            }
        )
        path = own_folder(self.folder, *Path(ply).parent.parts) / Path(ply).name
        if _known(record).get(ply) == digest:
            with suppress(RunFolderError):  # it is lost or damaged
                return Gaussians.load_ply(path, self.frame)
        made = make_level(
            part, start, self.views.train, level, steps=self.steps, context=self.context
        )
        if made is None:
            return None
        check_held(self.folder)
        made.save_ply(path, self.frame)
        write_json(record, _known(record) | {ply: digest})
        return Gaussians.load_ply(path, self.frame)


def _known(record: Path) -> dict[str, Any]:
    """What was made from what; nothing if that is not known."""
    try:
        known = read_json(record)
    except RunFolderError:
        return {}
    return known if isinstance(known, dict) else {}
