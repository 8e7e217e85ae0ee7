"""A surface's plan of memory: coarser where there is little."""

from __future__ import annotations

import numpy as np
import pytest

from roigs_engine.context import Context
from roigs_engine.model.scene import SfmScene
from roigs_engine.surface import memory
from roigs_engine.surface.make import SurfaceOptions, make_surface, surface_plan
from tests.engine.surface.ball import BOX, RADIUS, discs, images, photo

pytest.importorskip("skimage")
pytest.importorskip("trimesh")
EMPTY = np.zeros((0, 3))


def scene() -> SfmScene:
    return SfmScene(images=tuple(images()), points=EMPTY, colors=EMPTY.astype(np.uint8))


def test_with_enough_memory_all_is_as_fine_as_the_photos() -> None:
    plan = surface_plan(discs(), scene(), BOX)
    assert plan.coarser == 1
    assert plan.voxel < 0.01 and plan.texture >= 1024


def test_with_little_memory_a_surface_is_coarser_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A quarter of the machine holds 30,000 voxels of 48 x 50 x 51 / 0.025."""
    monkeypatch.setattr(memory, "machine_memory", lambda: 4 * memory.PER_VOXEL * 30_000)
    plan = surface_plan(discs(), scene(), BOX)
    assert plan.coarser > 1.5
    texts: list[str] = []
    context = Context(emit=lambda event: texts.append(getattr(event, "text", "")))
    made = make_surface(
        discs(), scene(), BOX, SurfaceOptions(faces=2000), load=photo, context=context
    )
    assert any("times coarser than its photos" in text for text in texts)
    volume = np.prod(2 * BOX.half_extents)
    assert volume / made.voxel**3 <= 30_000
    away = np.linalg.norm(made.mesh.vertices, axis=1) - RADIUS
    assert abs(np.median(away)) < made.voxel
    assert made.textured.charts.side <= plan.texture
