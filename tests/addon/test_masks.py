"""Masks of a box's object: strokes on photos, the engine's job, and the files."""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.fake_engine import use
from tests.addon.scenes import options

pytestmark = pytest.mark.blender

LINE = [(10.0, 12.0), (20.0, 14.0)]


@pytest.fixture
def box(blender: ModuleType, run):
    """The box of a scene with a run folder."""
    return run[0].objects["thing"]


def root(scene, folder: Path) -> Path:
    from roigs_addon.scene import masks

    return masks.folder(scene, folder)


def draw(box, photo: str, kind: str = "object") -> None:
    from roigs_addon.scene import scribbles

    scribbles.add_stroke(box, photo, kind, 3.0, LINE)


def names(scene) -> list[str]:
    from roigs_addon.scene import lookup

    return sorted(lookup.cameras(scene))


def test_a_place_in_the_view_and_on_the_photo() -> None:
    from roigs_addon.geometry.photo_places import in_region, on_photo, thinned, unit

    frame, size = (100.0, 50.0, 500.0, 350.0), (1600, 1200)
    assert on_photo((100, 350), frame, size) == (0, 0)
    assert on_photo((500, 50), frame, size) == (1600, 1200)
    assert unit(frame, size) == 4
    there = on_photo((217, 123), frame, size)
    np.testing.assert_allclose(in_region([there], frame, size), [(217, 123)])
    line = [(0.0, 0.0), (1.0, 0.0), (5.0, 0.0), (5.5, 0.0)]
    assert thinned(line, 2.0) == [(0.0, 0.0), (5.0, 0.0), (5.5, 0.0)]
    assert thinned(line[:1], 2.0) == line[:1]


def test_a_late_press_does_not_move_the_start_of_a_stroke() -> None:
    from roigs_addon.geometry.photo_places import start

    assert start((300.0, 200.0), (100.0, 101.0), (103.0, 100.0)) == (100.0, 101.0)
    assert start((300.0, 200.0), (100.0, 101.0), (302.0, 201.0)) == (300.0, 200.0)
    assert start((300.0, 200.0), None, (103.0, 100.0)) == (300.0, 200.0)


def test_strokes_are_kept_in_the_file(blender: ModuleType, run, box, tmp_path: Path) -> None:
    from roigs_addon.scene import lookup, scribbles

    first, second = names(run[0])[:2]
    draw(box, first)
    draw(box, first, "background")
    draw(box, second)
    blend = str(tmp_path / "a.blend")
    blender.ops.wm.save_as_mainfile(filepath=blend)
    blender.ops.wm.open_mainfile(filepath=blend)
    (again,) = lookup.rois(blender.context.scene)
    assert scribbles.photos(again) == sorted([first, second])
    kinds = [stroke["kind"] for stroke in scribbles.strokes(again, first)]
    assert kinds == ["object", "background"]
    assert scribbles.strokes(again, second)[0]["points"] == [list(point) for point in LINE]
    assert blender.ops.roigs.clear_strokes(photo=first) == {"FINISHED"}
    assert scribbles.photos(again) == [second]
    blender.ops.roigs.clear_strokes(every=True)
    assert scribbles.photos(again) == []


def test_the_engine_is_asked_for_the_boxs_photos(
    blender: ModuleType, run, box, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.scene import selections
    from roigs_engine.formats.scribbles import read_scribbles

    scene, folder = run
    use(monkeypatch, tmp_path, 'say(event="done", outputs={}, stopped=False)')
    photos = names(scene)
    with pytest.raises(RuntimeError, match="Draw strokes"):
        blender.ops.roigs.make_masks()
    draw(box, photos[0])
    selections.add_photos(box, photos[1:4])
    blender.ops.roigs.exclude_photos(photo=photos[2])
    assert blender.ops.roigs.make_masks() == {"FINISHED"}
    asked = options(folder, "masks")
    assert asked["only"] == ["thing"] and asked["photo"] == [photos[1], photos[3]]
    assert asked["model"] == str(folder / "result.ply")
    said = (folder / "blender" / "engine.log").read_text(encoding="utf-8")
    assert f"--out {root(scene, folder)}" in said
    (scribble,) = read_scribbles(Path(asked["scribbles"]))
    assert (scribble.box, scribble.photo, len(scribble.strokes)) == ("thing", photos[0], 1)
    assert "anew" not in asked
    blender.ops.roigs.make_masks(anew=True)
    assert options(folder, "masks")["anew"] is True


def test_the_panel_says_how_many_were_made_anew(
    blender: ModuleType, run, box, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.jobs import current, undo

    pushed: list[str] = []
    monkeypatch.setattr(undo, "push", pushed.append)
    said = "say(event='message', level='info', text=\"Box 'thing': 2 of 5 masks written to x.\")"
    use(monkeypatch, tmp_path, said + '\nsay(event="done", outputs={}, stopped=False)')
    draw(box, names(run[0])[0])
    assert blender.ops.roigs.make_masks() == {"FINISHED"}
    place = root(*run) / "thing"
    assert current.outcome() == f"thing: 2 of 5 masks written to {place}."
    assert not pushed  # nothing in Blender has changed


def test_masks_lie_beside_the_photos_if_that_can_be_written(
    run, project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.scene import masks

    scene, folder = run
    assert root(scene, folder) == project / "masks"
    monkeypatch.setattr(masks.os, "access", lambda *_: False)
    assert root(scene, folder) == folder / "blender" / "masks"
    put(folder / "blender/masks/thing/a.png")
    monkeypatch.undo()
    assert root(scene, folder) == folder / "blender" / "masks"  # they stay together


def put(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(os.fsencode(path))
    return path


def test_masks_in_the_run_folder_are_shown_used_and_removed(
    blender: ModuleType, run, box, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.jobs import options_files
    from roigs_addon.scene import masks
    from roigs_engine.formats.files import read_json, sha256
    from roigs_engine.formats.mask_record import record_masks

    scene, folder = run
    photo = names(scene)[0]
    monkeypatch.setattr(masks, "_beside_photos", lambda _: tmp_path / "masks")
    assert masks.file(scene, folder, box, photo) is None and not masks.are_there(scene, folder)
    made = put(tmp_path / "masks/thing" / f"{photo}.png")
    record_masks(made.parent, {made.name: sha256(made)})
    assert masks.file(scene, folder, box, photo) == made
    there = put(folder / "blender/masks/thing" / f"{photo}.png")
    record_masks(there.parent, {there.name: sha256(there)})
    assert masks.file(scene, folder, box, photo) == there  # newer than what was made there
    assert masks.photos(scene, folder, box) == [photo] and masks.are_there(scene, folder)
    asked = read_json(options_files.write_select_options(scene, [box]))
    assert asked["object_masks"] == str(folder / "blender/masks")
    made.write_bytes(b"a person's")
    assert masks.file(scene, folder, box, photo) == made
    assert blender.ops.roigs.remove_masks() == {"FINISHED"}
    assert made.exists() and not there.exists()


def test_stepping_through_masks_and_removing_them(blender: ModuleType, run, box) -> None:
    from roigs_addon.scene import lookup
    from roigs_engine.formats.files import sha256
    from roigs_engine.formats.mask_record import record_masks

    scene, folder = run
    out = folder / "blender/masks"
    photos = names(scene)
    with pytest.raises(RuntimeError, match="no masks yet"):
        blender.ops.roigs.step_mask(step=1)
    for photo in (photos[1], photos[3]):
        put(out / "thing" / f"{photo}.png")
    draw(box, photos[0])
    seen = []
    for step in (1, 1, 1, 1, -1):
        assert blender.ops.roigs.step_mask(step=step) == {"FINISHED"}
        seen.append(lookup.photo_record(scene.camera).name)
    assert seen == [photos[0], photos[1], photos[3], photos[0], photos[3]]
    assert scene.roigs.show_masks
    made = out / "thing" / f"{photos[1]}.png"
    record_masks(out / "thing", {f"{photos[1]}.png": sha256(made)})
    assert blender.ops.roigs.remove_masks() == {"FINISHED"}
    assert not made.exists() and (out / "thing" / f"{photos[3]}.png").exists()


def test_the_panel_says_what_to_do(blender: ModuleType, run, box) -> None:
    from roigs_addon.ui.masks import MasksPanel
    from tests.addon.panels import said

    scene, _ = run
    assert MasksPanel.poll(blender.context)
    assert "thing: draw on the object, with Ctrl around it" in " ".join(said(blender, MasksPanel))
    photo = names(scene)[0]
    draw(box, photo)
    blender.ops.roigs.look_through(photo=photo)
    assert "thing: strokes on 1 photo" in " ".join(said(blender, MasksPanel))


def test_an_image_is_read_for_the_overlay(blender: ModuleType, run, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    from roigs_addon.viewport import photo_overlay

    mask = np.zeros((6, 8), bool)
    mask[:2, :3] = True
    path = tmp_path / "m.png"
    image.fromarray(mask).save(path)
    key = str(path), path.stat().st_mtime_ns
    count = len(blender.data.images)
    photo_overlay._wanted[key] = True
    assert photo_overlay._read() is False
    shown = photo_overlay._textures.pop(key)
    np.testing.assert_array_equal(shown[::-1, :, 3] > 0, mask)
    assert len(blender.data.images) == count
    assert photo_overlay._pixels(tmp_path / "none.png") is None


def test_strokes_that_are_damaged_are_none(run, box) -> None:
    from roigs_addon.scene import scribbles

    item = box.roigs.scribbles.add()
    item.name, item.strokes = "x", "{"
    assert scribbles.strokes(box, "x") == [] and scribbles.photos(box) == []
    assert json.dumps(scribbles.document(box)) == '{"scribbles": []}'
