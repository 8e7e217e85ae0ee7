"""Gaussians for the tests of the add-on's viewport."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from roigs_engine.formats.splat_ply import write_ply
from roigs_engine.formats.targets import VIEWERS, Target, target_with

SH_C0 = 0.28209479177387814


def random_arrays(count: int, seed: int, coefficients: int = 16) -> dict[str, np.ndarray]:
    """Arrays of `write_ply`: Gaussians of many shapes in a ball of radius 1 about the origin."""
    random = np.random.default_rng(seed)
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    sh = random.normal(size=(count, coefficients, 3)) * 0.25
    sh[:, 0] = random.uniform(-1.5, 1.5, (count, 3))
    arrays = {
        "means": direction * random.uniform(size=(count, 1)) ** (1 / 3),
        "quats": random.normal(size=(count, 4)),
        "log_scales": random.uniform(np.log(0.004), np.log(0.12), (count, 3)),
        "logit_opacities": random.uniform(-3, 5, count),
        "sh": sh,
    }
    return {name: values.astype(np.float32) for name, values in arrays.items()}


def random_ply(
    path: Path, count: int, seed: int = 0, coefficients: int = 16, *, antialiased: bool = False
) -> Path:
    """`random_arrays` as a file."""
    write_ply(
        path, random_arrays(count, seed, coefficients), target=target_with(antialiased=antialiased)
    )
    return path


def fine_ply(
    path: Path,
    count: int,
    seed: int = 0,
    *,
    thinner: float = 6.0,
    target: Target = VIEWERS,
    photo_focal: float | None = None,
) -> Path:
    """The same with Gaussians so much finer, on which anti-aliasing has an effect."""
    arrays = random_arrays(count, seed)
    arrays["log_scales"] -= np.float32(np.log(thinner))
    arrays["logit_opacities"] += np.float32(2.0)
    write_ply(path, arrays, target=target, photo_focal=photo_focal)
    return path


def recoloured(sh: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """The coefficients of colours that are `gains` times as large."""
    changed = sh * gains
    changed[:, 0] += 0.5 * (gains - 1) / SH_C0
    return changed.astype(np.float32)
