"""Compares the content read from a file with the values it was built from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roigs_engine.cli import main
from roigs_engine.exchange import formats
from roigs_engine.formats.splat_ply import read_ply

# Allowed rounding of files.
STEPS = {"means": 1e-3, "log_scales": 1e-4, "logit_opacities": 0.1, "sh": 0.02, "quats": 0.01}
EXACT = dict.fromkeys(STEPS, 1e-4)


def assert_holds(
    path: Path, model: dict[str, np.ndarray], steps: dict[str, float] | None = None
) -> None:
    """The file has these Gaussians, with rotations of either sign."""
    found = formats.read(path)
    for name, near in (steps or EXACT).items():
        rows = found[name]
        if name == "quats":
            rows = rows * np.sign((rows * model[name]).sum(axis=1, keepdims=True))
        wanted = model[name][:, :16] if name == "sh" else model[name]
        np.testing.assert_allclose(rows, wanted, atol=near, err_msg=name)


def converted(tmp_path: Path, source: Path, *options: str, to: str = "out.ply") -> dict[str, Any]:
    assert main(["convert", str(source), str(tmp_path / to), *options]) == 0
    return read_ply(tmp_path / to)


def with_zstd(version: int) -> None:
    if version == 4:
        pytest.importorskip("zstandard")
