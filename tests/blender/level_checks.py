"""Checks of levels of detail in the viewport; run as viewport_checks.py, on its folder."""

from __future__ import annotations

import shutil
import sys
import time
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from roigs_addon.viewport import painter as drawing
from roigs_addon.viewport.painter import Painter
from roigs_engine.formats.levels import FADE
from tests.addon.levels_cases import make_levels
from tests.blender.checks import FOLDER, SIDE, glance, run_checks, splats
from tests.blender.gpu_pictures import psnr


def levelled() -> bpy.types.Object:
    """An object of a run folder whose box has three levels."""
    folder = FOLDER / "run"
    (folder / "rois").mkdir(parents=True, exist_ok=True)
    shutil.copyfile(FOLDER / "a.ply", folder / "rois" / "thing.ply")
    rate = 0.4 * SIDE  # of a picture from `DISTANCE` that is 4 times as fine
    make_levels(folder, rate=rate, parts=["rois/thing.ply"], probes=np.zeros((1, 3)))
    item = splats("thing", folder / "rois" / "thing.ply")
    item.roigs.level = "ROI"
    return item


def check_levels(_a: bpy.types.Object, _b: bpy.types.Object) -> None:
    """From afar a coarser file is drawn, in between two of them: the same after any views."""
    item, scene = levelled(), bpy.context.scene
    painter = Painter()
    whole = {size: glance(item, size, painter, wait=True) for size in (1.0, 0.3, 0.1)}
    assert painter.counts[0] == (150, 600)
    assert [Path(f.path).parts[-3] for f in painter._set.files] == ["run", "1", "2"]
    scene.roigs.use_levels = False
    full = {size: glance(item, size, painter, wait=True) for size in (1.0, 0.3, 0.1)}
    assert painter.counts[0] == (600, 600)
    scene.roigs.use_levels = True
    assert (whole[1.0] == full[1.0]).all()
    for size, number in ((0.3, 1), (0.1, 2)):
        alone = splats("alone", FOLDER / "run" / "levels" / str(number) / "rois" / "thing.ply")
        got = glance(alone, size, Painter(), wait=True)
        assert np.abs(whole[size] - got).max() < 1e-3, np.abs(whole[size] - got).max()
        assert psnr(got, full[size]) < 40, psnr(got, full[size])
        bpy.data.objects.remove(alone)
    # Both are there in the middle of a fade; beside a switch, little changes.
    middle, sizes = glance(item, 0.5 / FADE**0.5, painter, wait=True), (0.5001, 0.4999)
    assert painter.counts[0] == (900, 600)
    assert 0.9 < middle[..., 3].max() <= 1
    before, after = (glance(item, size, painter, wait=True) for size in sizes)
    assert np.abs(before - after).max() < 0.02
    painter.close()
    bpy.data.objects.remove(item)


def check_levels_being_read(_a: bpy.types.Object, _b: bpy.types.Object) -> None:
    """While a level is read or sorted, the one before stays: there is no hole."""
    item, painter = levelled(), Painter()
    held = glance(item, 0.1, painter, wait=True)
    assert painter.counts[0] == (150, 600)
    for _ in range(2):  # not read yet; then read, and mostly not sorted
        now = glance(item, 1.0, painter)
        assert now[..., 3].max() > 0.5 and painter.counts[0] in ((150, 600), (600, 600))
        while not painter.idle():
            time.sleep(0.01)
    for _ in range(3000):  # a minute
        now = glance(item, 1.0, painter)
        if painter.counts[0] == (600, 600):
            break
        assert now[..., 3].max() > 0.5
        time.sleep(0.02)
    assert painter.counts[0] == (600, 600)
    assert (now == glance(item, 1.0, painter, wait=True)).all()
    back = glance(item, 0.1, painter)
    assert painter.counts[0] == (600, 600), "sorted already?"
    assert psnr(back, held) > 15
    painter.close()
    bpy.data.objects.remove(item)


def check_levels_that_do_not_fit(_a: bpy.types.Object, _b: bpy.types.Object) -> None:
    """On a small GPU, one level of each is there, and nothing is refused."""
    item, painter = levelled(), Painter()
    glance(item, 1.0, painter, wait=True)
    most, drawing.most_rows = drawing.most_rows, lambda: 1
    try:
        for size, drawn in ((1.0, 600), (0.3, 300), (0.1, 150), (0.5 / 1.2**0.25, 600)):
            glance(item, size, painter, wait=True)
            assert len(painter._set.files) == 1 and not painter.problems
            assert painter.counts[0] == (drawn, 600)
    finally:
        drawing.most_rows = most
        painter.close()
    bpy.data.objects.remove(item)


if __name__ == "__main__":
    run_checks(globals())
