"""Facts about the scene's run folder in the panel."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from roigs_addon.engine.run_status import RunStatus
from tests.addon.scenes import add_box, imported, record

pytestmark = pytest.mark.blender


def test_the_panel_says_which_boxes_have_changed(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.facts import run_facts

    scene = imported(blender, project)
    scene.roigs.run_dir = str(tmp_path)
    roi = add_box(blender, "vase", (-1, -1, -1), (1, 1, 1))
    blender.context.view_layer.update()
    trained = RunStatus(boxes={"vase": tuple(list(record(roi, scene).values())[1:])})
    assert run_facts.changed_boxes(scene, trained) == []
    scene.roigs.root.location.x += 3
    blender.context.view_layer.update()
    assert run_facts.changed_boxes(scene, trained) == []
    roi.location.x += 0.1
    blender.context.view_layer.update()
    assert run_facts.changed_boxes(scene, trained) == ["vase"]
    assert run_facts.changed_boxes(scene, RunStatus()) == ["vase"]
