""".splat: 32 bytes for each Gaussian, without view-dependent colours (antimatter15/splat)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..formats.files import read_bytes, write_bytes
from ..model.gaussians import SH_C0
from .arrays import Arrays, Float32, logits, opacities, unit_quats

ROW = np.dtype(
    [("mean", "<f4", 3), ("scale", "<f4", 3), ("colour", "u1", 4), ("rotation", "u1", 4)]
)

LEAST = 1e-30
"""Stands for a scale of 0, which has no logarithm."""


def write(path: Path, arrays: Arrays) -> int:
    """See `FileFormat`. The largest and most opaque Gaussians come first, for streaming."""
    rows = np.empty(len(arrays["means"]), ROW)
    alpha = opacities(arrays)
    rows["mean"], rows["scale"] = arrays["means"], np.exp(arrays["log_scales"])
    rows["colour"][:, :3] = _bytes(0.5 + SH_C0 * arrays["sh"][:, 0].astype(np.float32))
    rows["colour"][:, 3] = _bytes(alpha)
    rows["rotation"] = np.clip(np.round(unit_quats(arrays) * 128 + 128), 0, 255)
    order = np.argsort(-arrays["log_scales"].sum(axis=1) - np.log(alpha + 1e-6), kind="stable")
    write_bytes(path, rows[order].tobytes())
    return len(rows)


def read(path: Path) -> Arrays:
    """See `FileFormat`."""
    data = read_bytes(path, most=None)
    if len(data) % ROW.itemsize:
        raise ValueError(f"{len(data)} bytes are no multiple of {ROW.itemsize}")
    rows = np.frombuffer(data, ROW)
    colours: Float32 = rows["colour"].astype(np.float32) / np.float32(255)
    return {
        "means": rows["mean"],
        "quats": (rows["rotation"].astype(np.float32) - 128) / 128,
        "log_scales": np.log(np.maximum(rows["scale"], LEAST)),
        "logit_opacities": logits(colours[:, 3]),
        "sh": ((colours[:, None, :3] - 0.5) / SH_C0).astype(np.float32),
    }


def _bytes(values: Float32) -> Float32:
    return np.asarray(np.clip(np.round(values * 255), 0, 255))
