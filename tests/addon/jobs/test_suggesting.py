"""Suggest Photos: the engine's cameras stand in the scene, with numbers, pictures and lines."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.panels import said
from tests.addon.scenes import add_box, imported, ready

pytestmark = pytest.mark.blender


def suggested(bpy: ModuleType, project: Path, run: Path):
    scene = ready(bpy, project, run)
    scene.roigs.suggested = 3
    assert bpy.ops.roigs.suggest_photos() == {"FINISHED"}
    bpy.context.view_layer.update()
    return scene


def test_the_engines_cameras_stand_in_the_scene(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.scene import lookup, suggestions

    bpy, scene = blender, suggested(blender, project, tmp_path / "run")
    out = tmp_path / "run" / "blender" / "suggested"
    records = json.loads((out / "suggestions.json").read_text(encoding="utf-8"))["cameras"]
    shots = suggestions.of_box(scene, lookup.rois(scene)[0])
    assert len(shots) == len(records) > 0
    assert [shot.name for shot in shots] == [f"{n + 1} thing" for n in range(len(shots))]
    root = lookup.matrix_world(scene.roigs.root)
    for shot, record in zip(shots, records, strict=True):
        assert shot.show_name and shot.users_collection[0].name == "Suggested Photos"
        pose = np.array(record["world_to_camera"])
        centre = root @ np.append(-pose[:3, :3].T @ pose[:3, 3], 1)
        assert np.allclose(lookup.matrix_world(shot)[:3, 3], centre[:3], atol=1e-5)
        behind = shot.data.background_images[0].image
        assert Path(bpy.path.abspath(behind.filepath)) == out / record["picture"]
    lines = next(item for item in shots[0].users_collection[0].objects if item.type == "MESH")
    assert len(lines.data.edges) == len(shots) and lines.hide_render
    corners = [lookup.matrix_world(lines) @ [*vertex.co, 1] for vertex in lines.data.vertices]
    assert np.allclose(corners[0][:3], lookup.matrix_world(lookup.rois(scene)[0])[:3, 3], atol=1e-5)
    # They are no photos: neither selection nor training sees them.
    assert not set(lookup.cameras(scene)) & {record["name"] for record in records}
    assert bpy.ops.roigs.look_through_suggestion(camera=shots[0].name) == {"FINISHED"}
    size = scene.render.resolution_x, scene.render.resolution_y
    assert scene.camera == shots[0] and size == (records[0]["width"], records[0]["height"])


def test_the_panel_says_the_gain_and_the_way(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.operators.suggest import OpenSuggestions
    from roigs_addon.scene import lookup, suggestions
    from roigs_addon.ui.suggestions import SuggestionsPanel

    bpy = blender
    empty = imported(bpy, project)
    empty.roigs.run_dir = str(tmp_path / "none")
    assert not OpenSuggestions.poll(bpy.context)
    scene = suggested(blender, project, tmp_path / "run")
    assert OpenSuggestions.poll(bpy.context)
    shots = suggestions.of_box(scene, lookup.rois(scene)[0])
    scene.camera = shots[0]
    labels = " ".join(said(bpy, SuggestionsPanel))
    known = suggestions.known_of(shots[0])
    assert known is not None
    assert all(word in labels for word in known.words.split())


def test_one_click_removes_all_and_a_second_run_replaces_them(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.scene import lookup, suggestions

    bpy = blender
    before = len(bpy.data.cameras), len(bpy.data.meshes), len(bpy.data.images)
    scene = suggested(blender, project, tmp_path / "run")
    count = len(list(lookup.of_kind(scene, "SHOT")))
    add_box(bpy, "second", (-0.4, -0.4, -0.4), (0.2, 0.2, 0.2))
    assert bpy.ops.roigs.suggest_photos() == {"FINISHED"}
    assert len(list(lookup.of_kind(scene, "SHOT"))) > count
    assert len(suggestions._collections(scene)) == 1
    assert bpy.ops.roigs.remove_suggestions() == {"FINISHED"}
    assert not list(lookup.of_kind(scene, "SHOT")) and not suggestions.are_there(scene)
    photos = len(lookup.cameras(scene))
    after = len(bpy.data.cameras), len(bpy.data.meshes), len(bpy.data.images)
    assert after[0] == before[0] + photos
    assert not [image for image in bpy.data.images if "suggested" in image.filepath]


def test_the_engine_names_photos_with_a_fault(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.scene import checked, exclusions, lookup

    scene = suggested(blender, project, tmp_path / "run")
    listed = tmp_path / "run" / "blender" / "suggested" / "suggestions.json"
    record = json.loads(listed.read_text(encoding="utf-8"))
    photo = record["boxes"][0]["photos"][0]
    fault = {"photo": photo, "reason": "blurred", "text": "blurred beyond use"}
    record["boxes"][0]["faults"] = [fault]
    listed.write_text(json.dumps(record), encoding="utf-8")
    roi = lookup.rois(scene)[0]
    places = checked.places_of([roi], scene)
    checked.take(scene, places, listed, "")
    assert checked.faults_of(roi) == ((photo, "blurred", "blurred beyond use"),)
    assert not exclusions.is_excluded(scene, photo)  # nothing is left out without a click
    record["boxes"][0]["faults"] = [{"photo": photo}]
    listed.write_text(json.dumps(record), encoding="utf-8")
    with pytest.raises(Exception, match="suggestions are unreadable"):
        checked.take(scene, places, listed, "")
    assert checked.faults_of(roi)  # the last check stays
