"""PLY -> format -> PLY with other axes up, by numbers.

Colours are compared through scipy's spherical harmonics, directions through its rotations: nothing
here is the engine's, except the command under test.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y

from roigs_engine.cli import main
from roigs_engine.exchange import formats
from roigs_engine.formats.splat_ply import read_ply, write_ply
from tests.engine.exchange.format_cases import READABLE, arrays, needed

Arrays = dict[str, np.ndarray]
POINTS_UP = {"-y": [0, -1, 0], "y": [0, 1, 0], "z": [0, 0, 1]}
# Errors: positions, logarithms of sizes, opacities, colours; others are exact.
MOST = {
    ".compressed.ply": (4e-3, 0.02, 0.003, 0.05),
    ".spz": (2e-3, 0.05, 0.003, 0.12),
    ".sog": (2e-4, 0.05, 0.003, np.inf),  # few share a set of SH
    ".splat": (1e-6, 0.05, 0.003, np.inf),
}
DIRECTIONS = Rotation.random(40, random_state=0).as_matrix()[:, 0]


def harmonics(directions: np.ndarray, bands: int) -> np.ndarray:
    """(D, bands) real spherical harmonics with the Condon-Shortley phase, by degree and order."""
    x, y, z = directions.T
    polar, around = np.arccos(np.clip(z, -1, 1)), np.arctan2(y, x)
    columns = []
    for degree in range(int(np.sqrt(bands))):
        for order in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(order), polar, around)
            part = value.imag if order < 0 else value.real
            columns.append(part * (np.sqrt(2) if order else 1))
    return np.stack(columns, axis=1)


def colours(values: Arrays, directions: np.ndarray) -> np.ndarray:
    return np.einsum("dk,nkc->ndc", harmonics(directions, values["sh"].shape[1]), values["sh"])


def shapes(values: Arrays) -> np.ndarray:
    """(N, 3, 3) logarithms of the ellipsoids' matrices."""
    axes = Rotation.from_quat(np.roll(values["quats"], -1, axis=1)).as_matrix()
    return np.einsum("nij,nj,nkj->nik", axes, values["log_scales"], axes)


def alphas(values: Arrays) -> np.ndarray:
    return 1 / (1 + np.exp(-values["logit_opacities"].astype(np.float64)))


def rotation(before: str, after: str) -> np.ndarray:
    """About the x axis, from one that points up to another."""
    angles = {axis: np.arctan2(up[2], up[1]) for axis, up in POINTS_UP.items()}
    return Rotation.from_rotvec([angles[after] - angles[before], 0, 0]).as_matrix()


def assert_turned(found: Arrays, model: Arrays, turn: np.ndarray, most: tuple[float, ...]) -> None:
    """The found model is the model after a rotation, in any order."""
    _, order = cKDTree(model["means"] @ turn.T).query(found["means"])
    assert sorted(order) == list(range(len(model["means"])))
    wanted = {name: values[order] for name, values in model.items()}
    errors = (
        found["means"] - wanted["means"] @ turn.T,
        shapes(found) - turn @ shapes(wanted) @ turn.T,
        alphas(found) - alphas(wanted),
        colours(found, DIRECTIONS @ turn.T) - colours(wanted, DIRECTIONS),
    )
    worst = [np.abs(error).max() for error in errors]
    assert all(value <= limit for value, limit in zip(worst, most, strict=True)), worst


@pytest.mark.parametrize("after", POINTS_UP)
@pytest.mark.parametrize("form", READABLE, ids=lambda form: form.suffix)
def test_there_and_back(form: formats.FileFormat, after: str, tmp_path: Path) -> None:
    needed(form)
    model = arrays()
    write_ply(tmp_path / "in.ply", model)
    made, back = tmp_path / f"made{form.suffix}", tmp_path / "back.ply"
    assert main(["convert", str(tmp_path / "in.ply"), str(made), f"--up={after}"]) == 0
    assert main(["convert", str(made), str(back), "--from-up=y", "--up=z"]) == 0
    most = MOST.get(form.suffix, (1e-5, 1e-5, 1e-5, 1e-5))
    assert_turned(read_ply(back), model, rotation("y", "z") @ rotation("-y", after), most)


def test_from_format_to_format(tmp_path: Path) -> None:
    exact = [form for form in READABLE if form.suffix not in MOST]
    for form in exact:
        needed(form)
    model, before = arrays(), tmp_path / "in.ply"
    write_ply(before, model)
    for number, form in enumerate([*exact, exact[0]]):
        after = tmp_path / f"{number}{form.suffix}"
        assert main(["convert", str(before), str(after)]) == 0
        before = after
    assert_turned(read_ply(before), model, np.eye(3), (1e-5, 1e-5, 1e-5, 1e-5))
