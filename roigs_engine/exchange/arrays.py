"""Models as arrays, as in `formats.splat_ply`, with their up axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..formats.splat_ply import Floats
from ..model.scene import Float64

Float32 = NDArray[np.float32]
Arrays = Mapping[str, Floats]
"""`means` (N, 3), `quats` (N, 4), `log_scales` (N, 3), `logit_opacities` (N,), `sh` (N, K, 3)."""


def unit_quats(arrays: Arrays) -> Float32:
    """Return (N, 4) unit quaternions, wxyz."""
    quats = arrays["quats"].astype(np.float64)
    lengths = np.linalg.norm(quats, axis=1, keepdims=True)
    return np.asarray((quats / np.where(lengths > 0, lengths, 1)).astype(np.float32))


def opacities(arrays: Arrays) -> Float32:
    """Return the opacities (N,), from 0 to 1."""
    with np.errstate(over="ignore"):
        values: Float32 = (1 / (1 + np.exp(-arrays["logit_opacities"]))).astype(np.float32)
    return values


def logits(opacity: Floats) -> Float32:
    """Return the inverse of `opacities`, also for values that files round to 0 or 1."""
    inside = np.clip(opacity.astype(np.float64), 1e-6, 1 - 1e-6)
    return np.asarray(np.log(inside / (1 - inside)).astype(np.float32))


def extent(means: Float64) -> float:
    """Return the size of a model (N, 3) along its longest axis, without outliers."""
    return float(np.ptp(np.quantile(means, (0.01, 0.99), axis=0), axis=0).max())


def flaw(arrays: Arrays) -> str:
    """Return why these arrays are no Gaussians, or an empty text if they are."""
    count, bands = len(arrays["means"]), arrays["sh"].shape[1:2]
    if bands not in {(1,), (4,), (9,), (16,)}:
        return "its colours have no degree from 0 to 3"
    shapes = {"means": (3,), "quats": (4,), "log_scales": (3,), "logit_opacities": ()}
    shapes["sh"] = (*bands, 3)
    wrong = [name for name, shape in shapes.items() if arrays[name].shape != (count, *shape)]
    return f"its attributes do not belong together ({wrong[0]})" if wrong else ""


def joined(parts: Sequence[Arrays]) -> Arrays:
    """Join models into one with their highest SH degree; ValueError if a part is no model."""
    if len(parts) == 1:
        return parts[0]
    for part in parts:
        if problem := flaw(part):
            raise ValueError(problem)
    bands = max(part["sh"].shape[1] for part in parts)
    padded = [
        {**part, "sh": np.pad(part["sh"], ((0, 0), (0, bands - part["sh"].shape[1]), (0, 0)))}
        for part in parts
    ]
    return {name: np.concatenate([part[name] for part in padded]) for name in parts[0]}


def in_morton_order(arrays: Arrays) -> Arrays:
    """Sort Gaussians in Morton order; neighbours in space are then similar and compress better."""
    means = arrays["means"].astype(np.float64)
    low, high = np.quantile(means, (0.01, 0.99), axis=0)
    cells = np.clip((means - low) / np.maximum(high - low, 1e-30) * 1023, 0, 1023).astype(np.int64)
    key = np.zeros(len(means), np.int64)
    for bit in range(10):
        for axis in range(3):
            key |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    order = np.argsort(key, kind="stable")
    return {name: values[order] for name, values in arrays.items()}


UP: dict[str, tuple[tuple[int, int, int], ...]] = {
    "-y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
}
"""Up axis -> rotation into that world from one whose z axis points up."""


def turn(before: str, after: str) -> Float64:
    """Return the (4, 4) rotation of a model with the up axis `before` to the up axis `after`."""
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(UP[after]) @ np.array(UP[before]).T
    return matrix


def upright(up: Float64, after: str) -> Float64:
    """Return the (4, 4) rotation of a model with the up direction `up` (3,) to the axis `after`.

    It is the smallest rotation from `up` to the nearest axis of `UP`, followed by `turn`.
    """
    up = up / np.linalg.norm(up)
    before = max(UP, key=lambda axis: float(np.array(UP[axis])[:, 2] @ up))
    axis = np.array(UP[before], np.float64)[:, 2]
    cross = np.cross(up, axis)
    skew = np.cross(np.eye(3), cross)
    matrix = turn(before, after)
    matrix[:3, :3] = matrix[:3, :3] @ (np.eye(3) + skew + skew @ skew / (1 + up @ axis))
    return matrix
