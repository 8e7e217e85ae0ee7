"""Cleaning up Gaussians: what is chosen, deleted, drawn, exported, undone and saved."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.splat_ply import read_ply, target_of
from tests.addon.fake_engine import in_edit_mode, use
from tests.addon.scenes import add_box
from tests.addon.splat_cases import random_ply

pytestmark = pytest.mark.blender


@pytest.fixture
def scene(blender: ModuleType, run):
    """A scene with results and one box; its Gaussians are in a ball of radius 1."""
    blender.ops.roigs.load_results()
    for item in blender.context.selected_objects:
        item.select_set(False)
    return run[0]


def objects(scene) -> dict[str, object]:
    return {item.name: item for item in scene.objects if item.roigs.kind == "SPLATS"}


def points(item) -> np.ndarray:
    return np.array([vertex.co for vertex in item.data.vertices]).reshape(-1, 3)


def drawn(item) -> dict[str, np.ndarray]:
    """The Gaussians that viewport, renders and export show of an object."""
    from roigs_addon.scene import edits

    edits.look_again(item)
    return read_ply(edits.file_of(item))


def in_box(found: np.ndarray, half: float = 0.3) -> np.ndarray:
    return (np.abs(found) <= half).all(axis=1)


def test_outside_the_boxes(blender: ModuleType, scene) -> None:
    """Only of what is selected; boxes are found wherever the root is."""
    scene.roigs.root.location = (4, 5, 6)
    scene.roigs.root.scale = (2, 2, 2)
    blender.context.view_layer.update()
    box = add_box(blender, "other", (0, 0, 0), (1, 1, 1))
    box.matrix_basis.identity()
    box.matrix_parent_inverse.identity()
    box.location, box.scale = (0.5, 0.5, 0.5), (0.5, 0.5, 0.5)
    item, other = (objects(scene)[name] for name in ("Background", "thing Gaussians"))
    blender.ops.roigs.select_gaussians(name="Background")
    blender.context.view_layer.update()
    before, kept = points(item), len(points(other))
    stay = in_box(before) | in_box(before - 0.5, 0.5)
    assert 0 < stay.sum() < len(before)
    blender.ops.roigs.choose_by_box(where="OUTSIDE", action="DELETE")
    np.testing.assert_allclose(points(item), before[stay], atol=1e-6)
    np.testing.assert_allclose(drawn(item)["means"], before[stay], atol=1e-5)
    assert len(points(other)) == kept


def test_inside_the_active_box_of_all_that_is_visible(blender: ModuleType, scene) -> None:
    items = objects(scene)
    before = {name: points(item) + np.array(item.location) for name, item in items.items()}
    blender.ops.roigs.choose_by_box(where="INSIDE", action="DELETE")
    for name, item in items.items():
        coarse = name == "thing first pass"  # hidden
        assert len(points(item)) == (len(before[name]) if coarse else (~in_box(before[name])).sum())


def test_selected_first_then_deleted(blender: ModuleType, scene) -> None:
    from roigs_addon.scene import edits, point_edits

    item = objects(scene)["Background"]
    before = points(item)
    blender.ops.roigs.select_gaussians(name="Background")
    blender.ops.roigs.choose_by_box(where="INSIDE", action="SELECT")
    assert not edits.is_edited(item)
    assert point_edits.count_chosen([item]) == in_box(before).sum() > 0
    blender.ops.roigs.delete_chosen()
    assert len(points(item)) == (~in_box(before)).sum() and edits.is_edited(item)
    with pytest.raises(RuntimeError, match="No Gaussians are selected"):
        blender.ops.roigs.delete_chosen()
    blender.ops.roigs.choose_by_look(opacity=1.0, action="SELECT")
    blender.ops.roigs.forget_chosen()
    assert not point_edits.count_chosen([item])


def test_faint_and_large(blender: ModuleType, scene, run) -> None:
    from roigs_addon.scene import point_edits

    item = objects(scene)["Background"]
    item.scale = (3, 3, 3)
    blender.context.view_layer.update()
    blender.ops.roigs.select_gaussians(name="Background")
    stored = read_ply(run[1] / "background.ply")
    opacity = 1 / (1 + np.exp(-stored["logit_opacities"]))
    longest = 3 * np.exp(stored["log_scales"]).max(axis=1)
    blender.ops.roigs.choose_by_look(opacity=0.3)
    np.testing.assert_array_equal(point_edits.chosen(item), opacity < 0.3)
    blender.ops.roigs.choose_by_look(opacity=0.0, size=0.2, extend=True)
    either = (opacity < 0.3) | (longest > 0.2)
    np.testing.assert_array_equal(point_edits.chosen(item), either)
    assert (opacity < 0.3).any() and (longest > 0.2).any() and not either.all()


def test_hidden_points_stay(blender: ModuleType, scene) -> None:
    item = objects(scene)["Background"]
    hide = np.zeros(len(points(item)), bool)
    hide[:7] = True
    item.data.vertices.foreach_set("hide", hide)
    blender.ops.roigs.select_gaussians(name="Background")
    blender.ops.roigs.choose_by_look(opacity=1.0, action="DELETE")
    assert len(points(item)) == 7


def test_undone_saved_and_exported(
    blender: ModuleType, scene, engine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon import settings

    monkeypatch.setattr(settings, "data_folder", lambda: tmp_path / "user")
    blender.ops.ed.undo_push(message="before")
    blender.ops.roigs.select_gaussians(name="Background")
    blender.ops.ed.undo_push(message="selected")
    before = len(points(objects(scene)["Background"]))
    blender.ops.roigs.choose_by_box(where="OUTSIDE", action="DELETE")
    blender.ops.ed.undo_push(message="deleted")
    after = len(points(objects(scene)["Background"]))
    assert after < before
    blender.ops.ed.undo()
    scene = blender.context.scene
    assert len(drawn(objects(scene)["Background"])["means"]) == before
    blender.ops.ed.redo()
    scene = blender.context.scene
    assert len(drawn(objects(scene)["Background"])["means"]) == after
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    blender.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    item = objects(blender.context.scene)["Background"]
    assert len(drawn(item)["means"]) == after
    blender.ops.roigs.select_gaussians(name="Background")
    blender.ops.roigs.export_gaussians(filepath=str(tmp_path / "a.ply"), selected=True)
    assert len(read_ply(tmp_path / "a.ply")["means"]) == after


def test_objects_that_share_points_are_cleaned_once(blender: ModuleType, scene) -> None:
    item = objects(scene)["Background"]
    copy = item.copy()
    item.users_collection[0].objects.link(copy)
    inside = int(in_box(points(item)).sum())
    blender.ops.roigs.select_gaussians(name="Background")
    copy.select_set(True)
    before = len(points(item))
    blender.ops.roigs.choose_by_box(where="INSIDE", action="DELETE")
    assert len(points(copy)) == len(points(item)) == before - inside


def test_in_edit_mode_it_ends_first(blender: ModuleType, scene) -> None:
    blender.ops.roigs.select_gaussians(name="Background")
    blender.ops.object.mode_set(mode="EDIT")
    before = len(points(objects(scene)["Background"]))
    blender.ops.roigs.choose_by_look(opacity=1.0, action="DELETE")
    assert blender.context.mode == "OBJECT"
    assert len(points(objects(scene)["Background"])) == 0 < before


def test_everything_deleted_draws_nothing(blender: ModuleType, scene) -> None:
    from roigs_addon.scene import edits

    blender.ops.roigs.select_gaussians(name="Background")
    blender.ops.roigs.choose_by_look(opacity=1.0, action="DELETE")
    item = objects(scene)["Background"]
    edits.look_again(item)
    assert edits.file_of(item) == ""


def test_without_a_box_or_gaussians(blender: ModuleType, scene) -> None:
    for roi in [item for item in scene.objects if item.roigs.kind == "ROI"]:
        blender.data.objects.remove(roi)
    with pytest.raises(RuntimeError, match="Add a box first"):
        blender.ops.roigs.choose_by_box(action="DELETE")
    for item in objects(scene).values():
        item.hide_set(True)
    assert not blender.ops.roigs.choose_by_box.poll()
    assert not blender.ops.roigs.choose_by_look.poll()
    assert not blender.ops.roigs.find_floaters.poll()


def test_a_brush_stroke(blender: ModuleType, scene) -> None:
    """Orthographic from above, over the middle: all in a circle, or only what is in front."""
    from roigs_addon.geometry.picking import Sight
    from roigs_addon.operators.erase_brush import Stroke

    scene.roigs.root.rotation_quaternion = (1, 0, 0, 0)
    blender.context.view_layer.update()
    item = objects(scene)["Background"]
    blender.ops.roigs.select_gaussians(name="Background")
    view = np.eye(4)
    view[2, 3] = -10.0
    projection = np.diag([0.5, 0.5, -0.05, 1.0])
    sight = Sight(view, projection, (200, 200))
    before = points(item)
    wanted = np.hypot(*before[:, :2].T) <= 0.6
    stroke = Stroke(blender.context, sight, front=True)
    stroke.add([(100.0, 100.0)], 30.0)
    seen = len(stroke.places())
    stroke = Stroke(blender.context, sight, front=False)
    stroke.add([(100.0, 100.0)], 30.0)
    assert 0 < seen <= len(stroke.places()) == wanted.sum() < len(before)
    assert stroke.apply(blender.context, "DELETE").startswith(f"Deleted {wanted.sum()} Gaussians")
    np.testing.assert_allclose(points(item), before[~wanted], atol=1e-6)


def test_floaters_of_the_engine(blender: ModuleType, scene, engine) -> None:
    """The rule itself is tested with the engine; here, that its answer reaches the points."""
    from roigs_addon.jobs import current
    from roigs_addon.scene import point_edits

    blender.ops.roigs.select_gaussians(name="Background")
    assert blender.ops.roigs.find_floaters(action="SELECT") == {"FINISHED"}
    item = objects(scene)["Background"]
    count = point_edits.count_chosen([item])
    told = current.state().outcome
    word = "floater" if count == 1 else "floaters"
    assert told == f"Selected {count} {word} of {len(points(item))}"


def test_floaters_among_both_kinds(blender: ModuleType, scene, engine, tmp_path: Path) -> None:
    """With anti-aliasing and without."""
    from roigs_addon.scene import splats

    path = random_ply(tmp_path / "smooth.ply", 500, antialiased=True)
    splats.show_imported(scene, path, "Smooth", in_model=True)
    assert blender.ops.roigs.find_floaters(action="SELECT") == {"FINISHED"}
    written = list(Path(blender.app.tempdir).glob("roigs-floaters-*.ply"))
    assert sorted(target_of(path).antialiased for path in written) == [False, False, True]


ANSWER = """
import numpy as np
options = json.load(open(sys.argv[2]))
models = json.load(open(options["model"]))["models"]
def rows(path):
    head = open(path, "rb").read(2000).decode("latin-1")
    return int(head.split("element vertex ")[1].split()[0])
counts = [rows(model["ply"]) for model in models]
every = np.zeros(sum(counts), bool)
every[[0, 2, counts[0] - 1, counts[0]]] = True
np.save(sys.argv[sys.argv.index("--out") + 1], every)
say(event="done", outputs={}, stopped=False)
"""


def test_the_answer_belongs_to_the_points(
    blender: ModuleType, scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, tmp_path, ANSWER)
    item = objects(scene)["Background"]
    hide = np.zeros(len(points(item)), bool)
    hide[:3] = True
    item.data.vertices.foreach_set("hide", hide)
    before = points(item)
    assert blender.ops.roigs.find_floaters(action="DELETE") == {"FINISHED"}
    gone = {3, 5, len(before) - 1}  # of those that are not hidden
    stay = [row for row in range(len(before)) if row not in gone]
    np.testing.assert_allclose(points(item), before[stay], atol=1e-6)
    assert len(points(objects(scene)["thing Gaussians"])) == 41 - 1 + (2 - 1)


@pytest.mark.parametrize("action", ["SELECT", "DELETE"])
def test_floaters_of_an_object_in_edit_mode(
    blender: ModuleType, scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, action: str
) -> None:
    from roigs_addon.jobs import floaters_job
    from roigs_addon.operators.clean_up import act
    from roigs_addon.scene import point_edits

    use(monkeypatch, tmp_path, ANSWER)
    item = objects(scene)["Background"]
    before = len(points(item))
    spec = floaters_job.spec(blender.context, lambda found: act(found, action, what="floater"))
    assert "4 floaters" in in_edit_mode(item, spec)
    if action == "DELETE":
        assert len(points(item)) == before - 3
    else:
        assert np.flatnonzero(point_edits.chosen(item)).tolist() == [0, 2, before - 1]


def test_a_copy_that_stands_elsewhere_is_exported(
    blender: ModuleType, scene, engine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second vase: moved, rotated and scaled."""
    from roigs_addon import settings
    from roigs_engine.model.rotations import rotation_matrices  # noqa: F401 - the engine is there

    monkeypatch.setattr(settings, "data_folder", lambda: tmp_path / "user")
    item = objects(scene)["thing Gaussians"]
    blender.ops.roigs.select_gaussians(name=item.name)
    blender.ops.object.duplicate(linked=True)
    copy = blender.context.view_layer.objects.active
    copy.location, copy.scale = (3, 2, 1), (0.5, 0.5, 0.5)
    copy.rotation_euler = (0.4, -0.2, 1.0)
    blender.context.view_layer.update()
    item.select_set(True)
    blender.ops.roigs.export_gaussians(filepath=str(tmp_path / "a.ply"), selected=True, up="Z")
    found = read_ply(tmp_path / "a.ply")
    count = len(points(item))
    own = points(item)
    expected = []
    for shown in sorted((item, copy), key=lambda o: o.name):
        place = np.array(shown.matrix_world)
        expected.append(own @ place[:3, :3].T + place[:3, 3])
    np.testing.assert_allclose(found["means"], np.concatenate(expected), atol=1e-4)
    sizes = np.sort(found["log_scales"], axis=1)
    np.testing.assert_allclose(sizes[:count] - sizes[count:], np.log(2), atol=1e-3)


def test_the_panel(blender: ModuleType, scene) -> None:
    from roigs_addon.ui.clean_up import CleanUpPanel
    from tests.addon.panels import said

    assert CleanUpPanel.poll(blender.context)
    assert "Works on all visible Gaussians" in " ".join(said(blender, CleanUpPanel))
    blender.ops.roigs.select_gaussians(name="Background")
    blender.ops.roigs.choose_by_look(opacity=1.0)
    words = " ".join(said(blender, CleanUpPanel))
    assert "Works on Background" in words and "Delete 41 Selected" in words
