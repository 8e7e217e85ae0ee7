"""Levels of detail for the tests of the add-on: every 2nd, 4th, ... Gaussian of a run's files."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from roigs_engine.formats.levels import Ladder, Level, write_ladders
from roigs_engine.formats.splat_ply import read_ply, write_ply

FAR, NEAR = 1e9, 1e-9
"""Rates of photos beside which every view is coarse, or fine."""


def make_levels(
    folder: Path,
    *,
    rate: float,
    parts: Sequence[str] = ("rois/thing.ply", "background.ply"),
    farther: Sequence[float] = (2.0, 4.0),
    probes: np.ndarray | None = None,
) -> list[Ladder]:
    """Write `levels.json` and the levels of some files of a run folder.

    Args:
        folder: of the run.
        rate: of the photos, see `Ladder`.
        parts: files of the run folder.
        farther: of the levels after the first one.
        probes: as `Ladder` has them; None: some of the Gaussians' centres.
    """
    ladders = []
    for part in parts:
        arrays = read_ply(folder / part)
        count = len(arrays["means"])
        levels = [Level(ply=part, gaussians=count, farther=0.0, measured={})]
        for number, value in enumerate(farther, 1):
            path = folder / "levels" / str(number) / part
            path.parent.mkdir(parents=True, exist_ok=True)
            write_ply(path, {name: rows[:: 2**number] for name, rows in arrays.items()})
            kept = len(arrays["means"][:: 2**number])
            ply = path.relative_to(folder).as_posix()
            levels.append(Level(ply=ply, gaussians=kept, farther=value, measured={}))
        chosen = arrays["means"][:50].astype(float) if probes is None else probes
        box = Path(part).stem if "/" in part else ""
        ladders.append(Ladder(box=box, rate=rate, probes=chosen, levels=tuple(levels)))
    write_ladders(folder, ladders)
    return ladders


def age(path: Path, seconds: float) -> None:
    """Have a file written that long after, or before, it was."""
    written = path.stat().st_mtime + seconds
    os.utime(path, (written, written))
