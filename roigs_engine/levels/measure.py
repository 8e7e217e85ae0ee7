"""From how far a level does: measured on views that it was not trained on.

The truth is the whole part drawn without aliasing, alone. A level does from where it is at least as
near to that as the whole part itself is when it is drawn as viewers draw it, one sample per pixel,
or so near that nobody sees a difference: the whole part may be nearly right itself. From there on
it looks no worse and costs less.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ..context import QUIET, Context
from ..evaluation.metrics import psnr_from_mse
from ..formats.levels import FADE
from ..model.gaussians import Gaussians
from ..rasterize.view import View
from .parts import Part
from .teacher import samples_for, small_picture, views_at

GREY = 0.5
STEP = 2 ** (1 / 3)
"""Between two distances that are measured."""
NEAREST = STEP
FARTHEST = 8.0
APART = FADE**2
"""Factor from where a level begins to where the next may: between two fades is one level alone."""
ENOUGH = 40.0  # dB; a mean error of 2.5 of 255


@dataclass(frozen=True, kw_only=True)
class Measured:
    """A model at a distance, mean over views.

    Attributes:
        coarser: than the photos, see `formats.levels`.
        whole: PSNR of the whole part drawn as viewers draw it, against the truth, dB.
        level: PSNR of the level against the truth, dB.
        between: PSNR of the level against the whole part as viewers draw it, dB.
    """

    coarser: float
    whole: float
    level: float
    between: float


def distances() -> list[float]:
    """The distances that are measured, in those of the photos."""
    count = round(math.log(FARTHEST / NEAREST, STEP)) + 1
    return [NEAREST * STEP**k for k in range(count)]


@torch.no_grad()
def measure(
    part: Part, levels: Sequence[Gaussians], views: Sequence[View], context: Context = QUIET
) -> list[list[Measured]]:
    """For each level, how it looks at each distance that the views can show."""
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
    """The nearest distance from which on a level does; None: nowhere."""
    good: Measured | None = None
    for record in reversed(records):
        if record.level < min(record.whole, ENOUGH):
            break
        good = record
    return good


def spaced(steps: Sequence[float]) -> list[float]:
    """Distances at which levels begin, far enough apart."""
    result: list[float] = []
    for step in steps:
        result.append(max([step, *(APART * before for before in result[-1:])]))
    return result


def _error(picture: torch.Tensor, truth: torch.Tensor) -> float:
    return float(((picture - truth) ** 2).double().mean())
