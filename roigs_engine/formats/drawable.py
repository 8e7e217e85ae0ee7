"""The rule for valid Gaussians, for pictures, Blender's viewport and files; numpy only."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from .splat_ply import Floats

MOST = {"means": 1e15, "quats": 1e15, "log_scales": 60.0, "sh": 1e6}
"""Largest numbers with which a Gaussian can be drawn."""

FLAT = -60.0
"""Logarithm of a size that counts as 0. Smaller ones would only waste entries of codebooks."""

CERTAIN = 80.0
"""Logit of an opacity that is 1 in float32."""


def drawable(arrays: Mapping[str, Floats]) -> NDArray[np.bool_]:
    """Mask of the drawable Gaussians: without NaN, too large numbers, or a missing rotation.

    Two kinds of Inf can be drawn, as programs write them for exact values: a logarithm of -Inf is
    the size 0 of a flat Gaussian, and a logit of +-Inf is the opacity 1 or 0.

    The arrays are in the form of `splat_ply.write_ply`; the result is (N,).
    """
    good: NDArray[np.bool_] = ~np.isnan(arrays["logit_opacities"])
    for name, most in MOST.items():
        values = arrays[name]
        # This excludes NaN, which is not below any number.
        inside = (values if name == "log_scales" else np.abs(values)) < most
        good &= inside.all(axis=tuple(range(1, values.ndim)))
    with np.errstate(over="ignore", invalid="ignore"):  # from numbers excluded above
        # Test the length, not the numbers: in float32, tiny numbers have length 0, too.
        good &= np.linalg.norm(arrays["quats"], axis=1) > 0
    return good


def usable(
    arrays: Mapping[str, Floats], good: NDArray[np.bool_] | None = None
) -> Mapping[str, Floats]:
    """Remove Gaussians that cannot be drawn, and make all numbers of the others finite.

    The others keep their order. Sizes are at least e^`FLAT`, and logits of opacities from
    -`CERTAIN` to `CERTAIN`. No other number changes.

    Args:
        arrays: in the form of `splat_ply.write_ply`.
        good: the result of `drawable`, if the caller has it.
    """
    good = drawable(arrays) if good is None else good
    found = dict(arrays) if good.all() else {name: each[good] for name, each in arrays.items()}
    if (found["log_scales"] < FLAT).any():
        found["log_scales"] = np.maximum(found["log_scales"], np.float32(FLAT))
    if (np.abs(found["logit_opacities"]) > CERTAIN).any():
        clipped = np.clip(found["logit_opacities"], -CERTAIN, CERTAIN)
        found["logit_opacities"] = clipped.astype(np.float32)
    return found
