"""Levels drawn by a viewport: the wanted ones, among those already on the GPU."""

from __future__ import annotations

from collections import Counter
from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.levels import FADE, Ladder, Level

pytestmark = pytest.mark.blender

COUNTS = (800, 400, 200)
FADING = 2.0 * FADE**0.25
"""How many times coarser than its photos a view must be to show levels 0 and 1 together."""


@pytest.fixture
def make(blender: ModuleType):
    """A function that makes an object at a distance, with levels or without."""
    from mathutils import Matrix

    from roigs_addon.scene.ladders import Detail
    from roigs_addon.viewport.objects import FileKey, Levels, SplatObject

    def made(coarser: float, name: str = "a", *, levels: bool = True, visible: bool = True):
        files = tuple(FileKey(f"{name}{k}", 0, 0) for k in range(3))
        ladder = Ladder(
            box=name,
            rate=100.0,
            probes=np.zeros((1, 3)),
            levels=tuple(
                Level(ply=file.path, gaussians=count, farther=farther, measured={})
                for file, count, farther in zip(files, COUNTS, (0.0, 2.0, 4.0), strict=True)
            ),
        )
        detail = Detail(ladder=ladder, files=tuple(f.path for f in files), quality=1.0)
        place = Matrix.Translation((0, 0, -coarser))
        held = Levels(detail, files) if levels else None
        return SplatObject(files[0], place, visible, (1, 1, 1), levels=held)

    return made


@pytest.fixture
def view(blender: ModuleType):
    """100 pixels per unit at a distance of 1, as `rate` of the ladders."""
    from mathutils import Matrix

    from roigs_addon.viewport.view import View

    clip = Matrix(((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, -1, -0.1), (0, 0, -1, 0)))
    return View(Matrix(), clip, (200, 200))


def keys(*names: str):
    from roigs_addon.viewport.objects import FileKey

    return tuple(FileKey(name, 0, 0) for name in names)


def shown(items) -> dict[str, float]:
    return {item.file.path: item.density for item in items if item.visible}


@pytest.mark.parametrize(
    ("coarser", "names"), [(1.0, {"a0"}), (3.0, {"a1"}), (9.0, {"a2"}), (FADING, {"a0", "a1"})]
)
def test_a_view_shows_one_level_or_two(make, view, coarser: float, names: set[str]) -> None:
    from roigs_addon.viewport.levels_in_view import InView

    seen = shown(InView.of([make(coarser)], view).wanted())
    assert seen.keys() == names and sum(seen.values()) == pytest.approx(1)
    assert len(InView.of([make(coarser)], view).wanted()) == 3
    assert not shown(InView.of([make(coarser, visible=False)], view).wanted())
    assert shown(InView.of([make(coarser, levels=False)], view).wanted()) == {"a0": 1.0}


def test_an_orthographic_view(blender: ModuleType, make) -> None:
    """50 pixels per unit, wherever the object is."""
    from mathutils import Matrix

    from roigs_addon.viewport.levels_in_view import InView
    from roigs_addon.viewport.view import View

    for size, name in ((200, "a0"), (60, "a1"), (20, "a2")):
        view = View(Matrix(), Matrix.Diagonal((1.0, 1.0, -0.001, 1.0)), (size, size))
        for away in (1.0, 100.0):
            assert shown(InView.of([make(away)], view).wanted()) == {name: 1.0}


def test_a_larger_copy_is_finer(blender: ModuleType, make, view) -> None:
    from dataclasses import replace

    from mathutils import Matrix

    from roigs_addon.viewport.levels_in_view import InView

    far = make(9.0)
    copy = replace(far, matrix=far.matrix @ Matrix.Scale(6, 4))
    items = InView.of([far, copy], view).wanted()
    assert [item.file.path for item in items if item.visible] == ["a2", "a0"]


@pytest.mark.parametrize(
    ("coarser", "there", "names"),
    [
        (3.0, ["a0"], {"a0": 1.0}),
        (3.0, ["a0", "a2"], {"a0": 1.0}),
        (3.0, ["a0", "a1", "a2"], {"a1": 1.0}),
        (9.0, ["a0", "a1"], {"a1": 1.0}),
        (1.0, ["a2"], {"a2": 1.0}),
        (FADING, ["a0"], {"a0": 1.0}),
        (FADING, ["a1"], {"a1": 1.0}),
        (FADING, ["b0"], None),
    ],
)
def test_what_is_there_stands_in(make, view, coarser: float, there, names) -> None:
    from roigs_addon.viewport.levels_in_view import InView

    seen = InView.of([make(coarser)], view)
    assert shown(seen.among(keys(*there))) == (shown(seen.wanted()) if names is None else names)


def test_copies_share_what_is_there(make, view) -> None:
    """One near, one far: the level that one of them takes is no longer there for the other."""
    from roigs_addon.viewport.levels_in_view import InView

    seen = InView.of([make(1.0), make(1.0), make(1.0, "b", levels=False)], view)
    items = seen.among(keys("a0", "a2", "b0"))
    assert [item.file.path for item in items if item.visible] == ["a0", "a2", "b0"]


def test_counts(make, view) -> None:
    from roigs_addon.viewport.levels_in_view import InView

    seen = InView.of([make(3.0), make(9.0, "b"), make(1.0, "c", levels=False)], view)
    files = keys("a0", "a1", "b2", "c0")
    ranges = ((0, 800), (800, 1200), (1200, 1400), (1400, 2200))
    assert seen.counts(files, ranges, files) == (400 + 200 + 800, 800 + 800 + 800)
    assert seen.counts(files, ranges, keys("a0", "b2", "c0")) == (800 + 200 + 800, 2400)


def test_without_fading_one_level_is_drawn(make, view) -> None:
    from roigs_addon.viewport.levels_in_view import InView

    seen = InView.of([make(FADING), make(9.0, visible=False)], view, fade=False)
    assert shown(seen.wanted()) == {"a0": 1.0}


def test_the_gpu_gets_what_is_needed_and_keeps_what_it_has(make, view) -> None:
    from roigs_addon.viewport.levels_in_view import InView
    from roigs_addon.viewport.painter import needed

    def names(coarser: float, *held: str) -> list[str]:
        items = InView.of([make(coarser)], view).wanted()
        return [file.path for file in needed(items, Counter(keys(*held)))]

    assert names(1.0) == ["a0"] and names(9.0) == ["a2"]
    assert names(FADING) == ["a0", "a1"]
    assert names(9.0, "a0", "b0") == ["a0", "a2"]
    near, far = make(1.0), make(9.0)
    for pair in ((near, far), (far, near)):  # the same files in the same order
        items = InView.of(pair, view).wanted()
        assert [f.path for f in needed(items, Counter(keys("a0", "a2")))] == ["a0", "a2"]
