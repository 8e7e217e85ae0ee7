"""Drawable Gaussians, and their numbers."""

from __future__ import annotations

import numpy as np
import pytest

from roigs_engine.formats.drawable import CERTAIN, FLAT, drawable, usable
from tests.engine.formats.gaussian_arrays import arrays


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("logit_opacities", np.inf, True),
        ("logit_opacities", -np.inf, True),
        ("logit_opacities", 1e30, True),
        ("logit_opacities", np.nan, False),
        ("log_scales", -np.inf, True),
        ("log_scales", -1e30, True),
        ("log_scales", np.inf, False),
        ("log_scales", 70, False),
        ("log_scales", np.nan, False),
        ("means", np.inf, False),
        ("means", -1e16, False),
        ("means", np.nan, False),
        ("sh", -np.inf, False),
        ("sh", np.nan, False),
        ("quats", 0, False),
        ("quats", 1e-30, False),
        ("quats", 1e30, False),
        ("quats", np.nan, False),
    ],
)
def test_one_number_of_one_gaussian(name: str, value: float, expected: bool) -> None:
    model = arrays()
    model[name][2] = value
    assert drawable(model).tolist() == [True, True, expected, *[True] * 4]
    found = usable(model)
    assert len({len(values) for values in found.values()} | {6 + expected}) == 1
    assert all(np.isfinite(values).all() for values in found.values())


def test_infinite_logarithms_become_finite_ones_and_all_else_stays() -> None:
    model = arrays()
    model["logit_opacities"][:2] = (np.inf, -np.inf)
    model["log_scales"][3, 1] = -np.inf
    found = usable(model)
    assert found["logit_opacities"][:2].tolist() == [CERTAIN, -CERTAIN]
    assert found["log_scales"][3, 1] == FLAT
    for name, values in model.items():
        there = np.isfinite(values)
        np.testing.assert_array_equal(found[name][there], values[there])
        assert found[name].dtype == np.float32
