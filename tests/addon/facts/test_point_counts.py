"""Points in a box, and photos that see it."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.colmap_project import write_project
from tests.addon.scenes import ROOT, add_box, command_line, imported

pytestmark = pytest.mark.blender

DEMO = ROOT / "demo" / "scene"


@pytest.fixture
def demo(blender: ModuleType, addon: ModuleType):
    scene = imported(blender, DEMO)
    for roi in json.loads((DEMO / "rois.json").read_text("utf-8"))["rois"]:
        add_box(blender, roi["name"], roi["min"], roi["max"])
    return scene


def test_counts_are_those_of_the_engine(demo) -> None:
    """Also, boxes written by the add-on contain the same points as those of rois.json."""
    from roigs_addon import settings
    from roigs_addon.engine.python import FOR_READING
    from roigs_addon.facts import point_counts
    from roigs_addon.scene import lookup

    engine = settings.engine(FOR_READING)
    text = command_line(engine, "inspect", DEMO, "--rois", DEMO / "rois.json").stdout
    found = {roi.name: point_counts.count(roi, demo) for roi in lookup.rois(demo)}
    assert len(found) == 3
    for name, (points, photos) in found.items():
        _, after = re.split(rf"(?:ROI|[Bb]ox) .{re.escape(name)}.", text)
        described = after.splitlines()[1].split()
        assert points == int(described[0]) > 0
        assert photos == int(described[described.index("on") + 1]) > 0


def test_counts_without_tracks_and_after_edits(
    blender: ModuleType, addon: ModuleType, tmp_path: Path, project: Path
) -> None:
    from roigs_addon.facts import point_counts
    from roigs_addon.scene import lookup

    scene = imported(blender, project)
    roi = add_box(blender, "thing", (-0.3, -0.3, -0.3), (0.3, 0.3, 0.3))
    before = point_counts.count(roi, scene)
    assert before[0] > 0 and before[1] == 8
    cloud = lookup.points(scene)
    cloud.data.clear_geometry()  # points that the user deletes are still in the model
    assert point_counts.count(roi, scene) == before
    imported(blender, write_project(tmp_path / "b", tracks=False))
    assert point_counts.count(roi, scene) == (before[0], None)
    shutil.rmtree(scene.roigs.model_cache)
    point_counts.forget()
    assert point_counts.count(roi, scene) == (before[0], None)


def test_a_large_model_is_counted_in_a_thread(
    blender: ModuleType, addon: ModuleType, project: Path, monkeypatch
) -> None:
    from roigs_addon.facts import point_counts

    scene = imported(blender, project)
    roi = add_box(blender, "vase", (-1, -1, -1), (1, 1, 1))
    blender.context.view_layer.update()
    monkeypatch.setattr(point_counts, "LARGE", 1)
    first = point_counts.count_soon(roi, scene)
    assert first == point_counts.count(roi, scene)
    roi.location.x += 100
    blender.context.view_layer.update()
    assert point_counts.count_soon(roi, scene) == first, "the last one, until the new one is there"
    while not point_counts._counter.idle():
        pass
    assert point_counts.count_soon(roi, scene) == (0, 0)
