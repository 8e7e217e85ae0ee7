"""Scenes at the edge of what there is, with compute shaders: as on the CPU."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from roigs_engine.gpu.program import Program
from tests.engine.odd_scenes import SCENES, SIZES, Model, as_on_the_cpu


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scene", SCENES)
def test_they_are_drawn_and_trained_as_on_the_cpu(
    software: Program, scene: Callable[[], Model], size: tuple[int, int]
) -> None:
    as_on_the_cpu(scene(), size, "gpu")
