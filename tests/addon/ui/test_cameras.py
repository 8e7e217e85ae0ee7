"""Step 3: what the panel says of the photos before, after and long after a check."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.panels import said
from tests.addon.scenes import add_box, imported, ready

pytestmark = pytest.mark.blender


def text(bpy: ModuleType) -> str:
    """What step 3 says, with its sub-panels closed."""
    from roigs_addon.ui.cameras import CamerasPanel

    return " ".join(said(bpy, CamerasPanel))


def selected(bpy: ModuleType) -> str:
    """What the sub-panel of the selected photos says."""
    from roigs_addon.ui.selected import SelectedPanel

    return " ".join(said(bpy, SelectedPanel))


def checked(bpy: ModuleType, project: Path, run: Path, **changed: object):
    """A scene with a box, of which the engine has checked the photos; some facts are changed."""
    scene = ready(bpy, project, run)
    scene.roigs.suggested = 2
    assert bpy.ops.roigs.check_photos() == {"FINISHED"}
    roi = bpy.data.objects["thing"]
    roi.roigs.checked = json.dumps(json.loads(roi.roigs.checked) | changed)
    return scene


def test_before_a_check(blender: ModuleType, addon: ModuleType, project: Path) -> None:
    imported(blender, project)
    assert "Add a box first" in text(blender)
    assert not blender.ops.roigs.check_photos.poll()
    add_box(blender, "thing", (-0.3, -0.3, -0.3), (0.3, 0.3, 0.3))
    assert "thing: photos not checked yet" in text(blender)
    assert "training selects its photos" in selected(blender)


def test_a_check_says_what_the_engine_says_and_changes_nothing_else(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.scene import checked as found_by
    from roigs_addon.scene import suggestions

    scene = checked(blender, project, tmp_path / "run")
    listed = tmp_path / "run" / "blender" / "suggested" / "suggestions.json"
    record = json.loads(listed.read_text(encoding="utf-8"))
    box, roi = record["boxes"][0], blender.data.objects["thing"]
    found = found_by.of_box(roi)
    assert found is not None
    assert found.suggested == len(record["cameras"]) == 2
    assert found.known == box["known"] <= found.later == record["cameras"][-1]["known"]
    assert f"thing: {box['pixels']:.0f} px across" in text(blender)
    assert not suggestions.are_there(scene) and not roi.roigs.selection
    assert not scene.roigs.excluded


def test_a_moved_box_is_checked_again(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    checked(blender, project, tmp_path / "run", faults=[["photo 1.png", "blurred", "blurred: 1%"]])
    blender.data.objects["thing"].location.x += 0.1
    blender.context.view_layer.update()
    assert "thing was moved: click Check Photos" in text(blender)
    assert "px across" not in text(blender) and "blurred" not in text(blender)
    blender.ops.roigs.select_cameras()
    assert "list of photos" not in text(blender)
    blender.data.objects["thing"].location.x += 0.1
    blender.context.view_layer.update()
    assert "Its list of photos is old, too" in text(blender)


def test_sides_without_photos_are_named_as_they_are_in_blender(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    """The engine names the axes of its own frame, in which the scene may lie on its side."""
    from mathutils import Matrix

    from roigs_addon.scene import rois

    scene = checked(blender, project, tmp_path / "run")
    roi = blender.data.objects["thing"]
    scene.roigs.root.matrix_world = Matrix.Identity(4)
    blender.context.view_layer.update()
    roi.matrix_world = Matrix.Scale(0.3, 4)
    blender.context.view_layer.update()
    facts = json.loads(roi.roigs.checked) | {"place": rois.place_key(roi, scene)}
    roi.roigs.checked = json.dumps(facts | {"without_photos": ["+x", "-z"]})
    assert "No photo from its +X side and below" in text(blender)
    scene.roigs.root.matrix_world = Matrix.Rotation(np.radians(-90), 4, "Y")  # +x is above now
    blender.context.view_layer.update()
    assert "No photo from above and its -Z side" in text(blender)
    roi.roigs.checked = json.dumps(facts | {"without_photos": []})
    assert "No photo" not in text(blender)


def test_exposures_that_differ_are_said(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    checked(blender, project, tmp_path / "run")
    roi = blender.data.objects["thing"]
    facts = json.loads(roi.roigs.checked)
    assert 0 < facts["exposure_spread"] < 0.3 and "xposures" not in text(blender)
    roi.roigs.checked = json.dumps(facts | {"exposure_spread": 2.94})
    assert "Exposures differ by 2.9 stops" in text(blender)
    del facts["exposure_spread"]  # as in files of earlier versions
    roi.roigs.checked = json.dumps(facts)
    assert "px across" in text(blender) and "xposures" not in text(blender)


def test_photos_that_were_added_are_to_be_checked(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    checked(blender, project, tmp_path / "run")
    assert "Photos were added" not in text(blender)
    roi = blender.data.objects["thing"]
    facts = json.loads(roi.roigs.checked)
    assert facts["of"] == 8
    roi.roigs.checked = json.dumps(facts | {"of": 6})
    assert "Photos were added: click Check Photos" in text(blender)


def test_a_photo_with_a_fault_is_named_until_it_is_excluded(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.operators.photos import ExcludePhotos

    fault = "photo 1.png", "out of focus", "out of focus at the object: 50% of the resolution"
    scene = checked(blender, project, tmp_path / "run", faults=[fault])
    assert "exclude the bad ones" in text(blender) and "out of focus" in text(blender)
    properties = type("Properties", (), {"reason": fault[2]})()
    assert "50% of the resolution" in ExcludePhotos.description(blender.context, properties)
    assert blender.ops.roigs.exclude_photos(photo=fault[0]) == {"FINISHED"}
    assert "out of focus" not in text(blender) and "1 photo excluded" in text(blender)
    assert [item.name for item in scene.roigs.excluded] == [fault[0]]


def test_the_list_of_photos(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    """Only a stale one is said with the sub-panel closed."""
    scene = ready(blender, project, tmp_path / "run")
    roi = blender.data.objects["thing"]
    for name in ("photo 2.png", "photo 5.png"):
        blender.ops.roigs.edit_selection(action="ADD", photo=name)
    assert "thing: 2 photos, chosen by hand" in selected(blender)
    blender.ops.roigs.select_cameras()
    assert f"thing: {len(roi.roigs.selection)} photos, best first" in selected(blender)
    assert "Select Again" not in text(blender)
    roi.location.x += 0.1
    blender.context.view_layer.update()
    assert "thing was moved: its list of photos is old" in text(blender)
    assert "Select Again" in text(blender) and "best first" not in selected(blender)
    assert "hardly changes the result" in selected(blender)
    scene.roigs.strategy = "independent"
    assert "on its selected photos alone" in selected(blender)


def test_suggestions_after_a_check_need_no_engine(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.jobs import current
    from roigs_addon.scene import suggestions

    bpy, scene = blender, checked(blender, project, tmp_path / "run")
    roi, job = blender.data.objects["thing"], current.job
    assert bpy.ops.roigs.suggest_photos() == {"FINISHED"} and current.job is job
    assert len(suggestions.of_box(scene, roi)) == 2
    assert bpy.ops.roigs.remove_suggestions() == {"FINISHED"}
    assert "px across" in text(bpy)  # what the check found stays
    scene.roigs.suggested = 1  # something else is asked
    assert bpy.ops.roigs.suggest_photos() == {"FINISHED"} and current.job is not job
    assert len(suggestions.of_box(scene, roi)) == 1
    for change in ("exclude", "rename"):
        job = current.job
        bpy.ops.roigs.remove_suggestions()
        if change == "exclude":
            bpy.ops.roigs.exclude_photos(photo="photo 3.png")
        else:
            roi.name = "other"
        assert bpy.ops.roigs.suggest_photos() == {"FINISHED"} and current.job is not job
        assert len(suggestions.of_box(scene, roi)) == 1
