"""Splits a result that was adapted to another renderer into its files. No bpy."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from ..errors import AddonError
from ..shared import EngineError, files, run_files, splat_ply
from .writing import made_folder

SHAPE = ("means", "quats", "log_scales")


def write(source: Path, adapted: Path, place: Path) -> None:
    """Write an adapted model as the folder of a result.

    The engine keeps the order of the Gaussians, and each part of a result has some of its rows.

    Args:
        source: folder of the original result.
        adapted: PLY of the whole adapted result.
        place: existing folder to write to. The first pass is copied unchanged.

    Raises:
        AddonError: a file of the result has changed since.
        EngineError, OSError: a file cannot be read or written.
    """
    whole, made = (splat_ply.read_ply(path) for path in (source / run_files.RESULT, adapted))
    if len(whole["means"]) != len(made["means"]):
        raise AddonError("The result has changed. Adapt it again.")
    how, rows = splat_ply.made_of(adapted), {k: i for i, k in enumerate(_keys(whole))}
    fine = made_folder(place, run_files.FINE)
    parts = sorted((source / run_files.FINE).glob("*.ply"))
    for path in (source / run_files.BACKGROUND, *parts):
        keys = _keys(splat_ply.read_ply(path))
        if not rows.keys() >= set(keys):
            raise AddonError(f"{path.name} is not a part of {run_files.RESULT}. Train again.")
        chosen = np.array([rows[key] for key in keys], np.int64)
        part = {name: values[chosen] for name, values in made.items()}
        splat_ply.write_ply((fine if path in parts else place) / path.name, part, **how)
    if first := files.matching(source / run_files.COARSE, "*.ply"):
        coarse = made_folder(place, run_files.COARSE)
        for path in first:
            _copy(path, coarse / path.name)
    try:
        settings = files.read_json(source / run_files.SETTINGS)
    except EngineError:
        settings = {}
    if isinstance(settings, dict):
        files.write_json(place / run_files.SETTINGS, settings | {"made_for": how["target"].name})
    splat_ply.write_ply(place / run_files.RESULT, made, **how)  # last: it makes the rest a result


def _copy(path: Path, to: Path) -> None:
    """Copy a file; a link in the place of the copy is replaced."""
    with open(path, "rb", opener=files.regular) as source, files.atomic_write(to) as target:
        shutil.copyfileobj(source, target)


def _keys(arrays: dict[str, splat_ply.Floats]) -> list[bytes]:
    """Return keys that tell Gaussians apart."""
    table = np.column_stack([arrays[name].astype(np.float64) for name in SHAPE])
    return [row.tobytes() for row in table]
