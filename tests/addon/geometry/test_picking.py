"""The point that a click means."""

from __future__ import annotations

import numpy as np
import pytest

from roigs_addon.geometry.picking import Sight, under

SIZE = (200, 100)
VIEW = np.eye(4)
VIEW[2, 3] = -5.0  # from z = 5 down


def sight(perspective: bool, scale: float = 1.0) -> Sight:
    near, far = 0.1 * scale, 100.0 * scale
    if perspective:
        projection = np.array(
            [
                [1.0, 0, 0, 0],
                [0, 2, 0, 0],
                [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
                [0, 0, -1, 0],
            ]
        )
    else:
        projection = np.diag([0.2 / scale, 0.4 / scale, -2 / (far - near), 1.0])
    view = VIEW.copy()
    view[2, 3] *= scale
    return Sight(view, projection, SIZE)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("perspective", [True, False])
def test_the_nearest_in_front(perspective: bool, scale: float) -> None:
    front, beside, behind = (0.0, 0, 1), (0.1, 0, 1.05), (0.01, 0, -3)
    points = scale * np.array([behind, beside, front])
    view = sight(perspective, scale)
    assert under(points, view, (100, 50)) == 2
    assert under(points[:1], view, (100, 50)) == 0
    assert under(points, view, (100, 90)) is None
    assert under(points[:0], view, (100, 50)) is None
    far_off = scale * np.array([behind, (0.25, 0, 2)])
    assert under(far_off, view, (100, 50)) == 0, "exactly at the mouse, though behind"
    assert under(np.array([[0, 0, 6.0 * scale]]), view, (100, 50)) is None or not perspective
