"""`levels.json`: the levels of detail of a result, and the rule that chooses a level.

A part (a box, or the surroundings) has a ladder of files, each with fewer Gaussians. The resolution
of a view, in pixels per unit of length on the part, decides between them. A level is used if the
view is at least `Level.farther` times coarser than the photos. The rule depends only on the view,
not on earlier views, so a picture is always the same. Between two levels, both are drawn: one fades
out, the other in.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import RunFolderError
from . import run_files
from .files import read_json, write_json
from .names import inner_path
from .transforms import numbers

Float64 = NDArray[np.float64]

VERSION = 1
FADE = 1.1
"""One level fades into the next while a view becomes coarser by this factor."""
NEAR_SHARE = 0.9
"""A view's rate is measured at the nearest tenth of the probes: this share is farther away."""
MOST = 1e30  # in any unit; larger numbers come from damaged files
HINT = "Make it again with `levels`."


@dataclass(frozen=True, kw_only=True)
class Level:
    """One file of a ladder."""

    ply: str  # relative to the run folder
    gaussians: int  # number of Gaussians
    farther: float  # for views at least this many times coarser than the photos; 0: first level
    measured: dict[str, float]  # name -> number; only for people to read


@dataclass(frozen=True, kw_only=True, eq=False)
class Ladder:
    """The levels of a part, the whole one first."""

    box: str  # name of the box; empty: the surroundings
    rate: float  # resolution of the photos on the part, pixels per unit of the COLMAP frame
    probes: Float64  # (P, 3) points in the COLMAP frame that represent the part
    levels: tuple[Level, ...]  # each `farther` is at least `FADE` times the one before


def write_ladders(folder: Path, ladders: list[Ladder]) -> None:
    """Write `levels.json` into a run folder."""
    parts = [
        {
            "box": ladder.box,
            "rate": ladder.rate,
            "probes": ladder.probes.tolist(),
            "levels": [asdict(level) for level in ladder.levels],
        }
        for ladder in ladders
    ]
    write_json(folder / run_files.LEVELS_FILE, {"version": VERSION, "parts": parts})


def read_ladders(folder: Path) -> dict[str, Ladder]:
    """Read the ladders of a run folder: box -> ladder; the surroundings are the box "".

    RunFolderError: there is no `levels.json`, or it is damaged or of another version.
    """
    path = folder / run_files.LEVELS_FILE
    record = read_json(path, hint=HINT)
    try:
        if record["version"] != VERSION:
            raise RunFolderError(f"{path} is of another version of the engine.", HINT)
        ladders = [_ladder(part) for part in record["parts"]]
        boxes = {ladder.box: ladder for ladder in ladders}
        if not boxes or len(boxes) < len(ladders):
            raise ValueError("it has no part, or one twice")
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise RunFolderError(f"{path} is malformed ({error}).", HINT) from error
    return boxes


def _ladder(record: Any) -> Ladder:
    probes = numbers(record["probes"], (None, 3), "probes", MOST)
    rate, levels = float(record["rate"]), tuple(_level(level) for level in record["levels"])
    if not isinstance(record["box"], str):
        raise ValueError("a part needs the name of its box")
    if not (1 / MOST < rate < MOST) or not levels or levels[0].farther != 0:
        raise ValueError("rate must be positive, and the first level whole")
    steps = [level.farther for level in levels[1:]]
    least = [0.0, *(FADE * (1 - 1e-9) * step for step in steps)]
    if not all(low <= step < MOST and step > 0 for low, step in zip(least, steps, strict=False)):
        raise ValueError(f"farther must grow, by {FADE} times at least")
    return Ladder(box=record["box"], rate=rate, probes=probes, levels=levels)


def _level(record: Any) -> Level:
    ply = str(record["ply"])
    if inner_path(ply) is None or not ply.encode().endswith(b".ply"):  # ValueError: not text
        raise ValueError(f"{ply} is no PLY in the run folder")
    return Level(
        ply=ply,
        gaussians=int(record["gaussians"]),
        farther=float(record["farther"]),
        measured={str(name): float(value) for name, value in record["measured"].items()},
    )


def rate_in_view(probes: Float64, to_clip: Float64, pixels: float) -> float:
    """Resolution of the probes in a view, pixels per unit of length; 0 if none is in view.

    Args:
        probes: (P, 3).
        to_clip: (4, 4) from the probes' frame to clip space: a point is in the picture if |x| and
            |y| are at most w, and w > 0.
        pixels: per unit of the probes' frame, where w is 1.
    """
    clip = probes @ to_clip[:, :3].T + to_clip[:, 3]
    w = clip[:, 3]
    shown = (w > 0) & (np.abs(clip[:, 0]) <= w) & (np.abs(clip[:, 1]) <= w)
    if not shown.any():
        return 0.0
    return float(pixels / np.quantile(w[shown], 1 - NEAR_SHARE))


def shown_levels(ladder: Ladder, rate: float, quality: float = 1.0) -> list[tuple[Level, float]]:
    """The levels to draw, and how much of each (`operations.faded`): one level, or two in a fade.

    `rate` is the result of `rate_in_view`. With a `quality` of 2, levels are chosen as for a view
    twice as fine.
    """
    coarser = math.inf if rate <= 0 else ladder.rate / (rate * max(quality, 1e-6))
    index = max(k for k, level in enumerate(ladder.levels) if level.farther <= coarser)
    level = ladder.levels[index]
    if not index or coarser >= level.farther * FADE:
        return [(level, 1.0)]
    share = math.log(coarser / level.farther) / math.log(FADE)
    both = [(ladder.levels[index - 1], 1.0 - share), (level, share)]
    return [(each, density) for each, density in both if density > 0]
