"""Select Cameras gives what the engine's command line gives; the list can be edited and is kept."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.scenes import add_box, command_line, ready, record

pytestmark = pytest.mark.blender


def chosen(roi) -> list[str]:
    return [item.name for item in roi.roigs.selection]


def selected(bpy: ModuleType, project: Path, run: Path):
    """The scene, with three photos selected for its box."""
    scene = ready(bpy, project, run)
    scene.roigs.count = 3
    bpy.ops.roigs.select_cameras()
    return scene


@pytest.mark.parametrize("method", ["coverage", "greedy", "static", "fvs", "random"])
def test_the_selection_is_the_engines(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path, method: str
) -> None:
    from roigs_addon import settings
    from roigs_addon.scene import lookup

    bpy, scene = blender, ready(blender, project, tmp_path / "run")
    add_box(bpy, "zweite", (-0.5, -0.5, -0.5), (0.0, 0.1, 0.2))
    scene.roigs.method, scene.roigs.count = method, 4
    assert bpy.ops.roigs.select_cameras() == {"FINISHED"}
    out = tmp_path / "by hand"
    engine = settings.engine(("numpy",))
    command_line(engine, "select", tmp_path / "run" / "blender" / "select.json", "--out", out)
    for roi in lookup.rois(scene):
        record = json.loads((out / f"{roi.name}.json").read_text(encoding="utf-8"))
        assert chosen(roi) == record["names"] and len(chosen(roi)) == 4
        assert [item.score for item in roi.roigs.selection] == pytest.approx(record["scores"])
    # The same boxes and options given by hand.
    arguments = ["--method", method, "--count", 4, "--max-side", 640, "--seed", 0]
    rois = tmp_path / "run" / "blender" / "rois.json"
    command_line(engine, "select", project, "--rois", rois, *arguments, "--out", tmp_path / "2")
    for path in out.iterdir():
        assert (tmp_path / "2" / path.name).read_bytes() == path.read_bytes()


def test_chosen_cameras_are_coloured_and_collected(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.scene import lookup
    from roigs_addon.scene.selections import CHOSEN_COLOUR

    bpy, scene = blender, selected(blender, project, tmp_path / "run")
    roi = lookup.rois(scene)[0]
    found = lookup.cameras(scene)
    green = {
        name for name, item in found.items() if tuple(item.color) == pytest.approx(CHOSEN_COLOUR)
    }
    assert green == set(chosen(roi))
    collection = scene.collection.children["thing Photos"]
    assert set(collection.objects) == {found[name] for name in green}
    scene.roigs.count = 2
    bpy.ops.roigs.select_cameras()
    assert len(collection.objects) == 2
    bpy.ops.roigs.remove_roi()
    assert "thing Photos" not in scene.collection.children
    assert len(lookup.cameras(scene)) == 8


def test_the_list_can_be_edited(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.jobs import options_files
    from roigs_addon.scene import lookup

    bpy, scene = blender, ready(blender, project, tmp_path / "run")
    edit = bpy.ops.roigs.edit_selection
    roi = lookup.rois(scene)[0]
    edit(action="ADD", photo="photo 2.png")
    lookup.cameras(scene)["photo 5.png"].select_set(True)
    lookup.cameras(scene)["photo 2.png"].select_set(True)
    edit(action="ADD")
    edit(action="ADD", photo="photo 7.png")
    assert chosen(roi) == ["photo 2.png", "photo 5.png", "photo 7.png"]
    roi.roigs.selection_index = 2
    edit(action="UP")
    edit(action="UP")
    edit(action="UP")
    assert chosen(roi) == ["photo 7.png", "photo 2.png", "photo 5.png"]
    assert roi.roigs.selection_index == 0
    edit(action="DOWN")
    assert chosen(roi) == ["photo 2.png", "photo 7.png", "photo 5.png"]
    edit(action="REMOVE")
    assert chosen(roi) == ["photo 2.png", "photo 5.png"]
    options_files.write_train_options(scene, [roi], 0.0)
    given = tmp_path / "run" / "blender" / "selection" / "thing.json"
    assert json.loads(given.read_text("utf-8"))["names"] == ["photo 2.png", "photo 5.png"]
    edit(action="CLEAR")
    edit(action="REMOVE")
    edit(action="DOWN")
    assert chosen(roi) == []
    path = options_files.write_train_options(scene, [roi], 0.0)
    assert "selection" not in json.loads(path.read_text("utf-8"))


def test_the_list_is_kept_in_the_file(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.scene import lookup, selections

    bpy, scene = blender, selected(blender, project, tmp_path / "run")
    roi = lookup.rois(scene)[0]
    names, before = chosen(roi), record(roi, scene)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    scene = bpy.context.scene
    roi = lookup.active_roi(bpy.context)
    assert chosen(roi) == names and record(roi, scene) == before
    assert not selections.is_stale(roi, scene)
    roi.location.x += 0.1
    bpy.context.view_layer.update()
    assert selections.is_stale(roi, scene)
