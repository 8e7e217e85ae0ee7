"""Gaussians that were deleted, hidden or moved in edit mode."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.splat_ply import read_ply, target_of
from tests.addon.results import choose, cut
from tests.addon.splat_cases import random_arrays, random_ply

pytestmark = [pytest.mark.blender, pytest.mark.exact_look]


@pytest.fixture
def background(blender: ModuleType, run):
    """An object with 30 Gaussians of a result."""
    random_ply(run[1] / "background.ply", 30, seed=4)
    blender.ops.roigs.load_results()
    item = blender.data.objects["Background"]
    for other in blender.context.selected_objects:
        other.select_set(False)
    item.select_set(True)
    blender.context.view_layer.objects.active = item
    return item


def drawn(item) -> dict[str, np.ndarray]:
    """The Gaussians that the viewport draws for an object."""
    from roigs_addon.viewport.objects import marked

    (found,) = marked([item])
    return read_ply(found.file.path)


def assert_rows(got: dict[str, np.ndarray], rows: object) -> None:
    """These rows of the file that was imported."""
    for name, values in random_arrays(30, seed=4).items():
        left, right = got[name], values[rows]
        if name == "quats":
            left, right = (
                quats / np.linalg.norm(quats, axis=1)[:, None] for quats in (left, right)
            )
        np.testing.assert_allclose(left, right, atol=1e-4)


@pytest.fixture
def smooth(blender: ModuleType, run, background):
    """An object with 20 anti-aliased Gaussians, selected; the other is not anti-aliased."""
    path = random_ply(run[1] / "smooth.ply", 20, seed=5, antialiased=True)
    from roigs_addon.scene import splats

    item = splats.show_imported(run[0], path, "Smooth", in_model=True)
    background.select_set(False)
    item.select_set(True)
    blender.context.view_layer.objects.active = item
    blender.context.view_layer.update()
    return item


def file_is_antialiased(item) -> bool:
    """Of the file that is drawn, rendered and exported for an object."""
    from roigs_addon.scene import edits

    edits.look_again(item)
    return target_of(edits.file_of(item)).antialiased


def test_edits_of_anti_aliased_gaussians_stay_so(
    blender: ModuleType, smooth, background, tmp_path: Path
) -> None:
    from roigs_addon.scene.splat_attributes import cloud_of

    assert cloud_of(smooth.data)[0].antialiased and not cloud_of(background.data)[0].antialiased
    blender.ops.object.duplicate()
    copy = blender.context.active_object
    choose(blender, copy, range(5))
    blender.ops.mesh.delete(type="VERT")
    blender.ops.object.mode_set(mode="OBJECT")
    assert len(drawn(copy)["means"]) == 15
    choose(blender, background, range(5))
    blender.ops.mesh.delete(type="VERT")
    blender.ops.object.mode_set(mode="OBJECT")
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "edited.blend"))
    blender.ops.wm.open_mainfile(filepath=str(tmp_path / "edited.blend"))
    for name, expected in (("Smooth", True), ("Smooth.001", True), ("Background", False)):
        assert file_is_antialiased(blender.data.objects[name]) is expected


def test_without_their_file_they_are_still_anti_aliased(
    blender: ModuleType, smooth, tmp_path: Path
) -> None:
    from roigs_addon.scene import edits

    Path(smooth.roigs.ply).unlink()
    assert file_is_antialiased(smooth)
    assert edits.file_of(smooth) != smooth.roigs.ply and len(drawn(smooth)["means"]) == 20


def test_parts_stay_anti_aliased(blender: ModuleType, smooth) -> None:
    """Separate, and join again."""
    from roigs_addon import viewport

    choose(blender, smooth, range(12))
    blender.ops.mesh.separate(type="SELECTED")
    blender.ops.object.mode_set(mode="OBJECT")
    part = next(i for i in blender.context.selected_objects if i != smooth)
    assert file_is_antialiased(part) and file_is_antialiased(smooth)
    blender.context.view_layer.objects.active = smooth
    blender.ops.object.join()
    assert file_is_antialiased(smooth) and len(drawn(smooth)["means"]) == 20
    assert not viewport.problems()


@pytest.mark.parametrize("into_smooth", [False, True])
def test_joined_with_others_most_decide_and_the_panel_says_so(
    blender: ModuleType, smooth, background, into_smooth: bool
) -> None:
    """There are 30 without anti-aliasing and 20 with it, whichever object is joined into."""
    from roigs_addon import viewport

    assert not viewport.problems()
    item = smooth if into_smooth else background
    background.select_set(True)
    blender.context.view_layer.objects.active = item
    blender.ops.object.join()
    assert not file_is_antialiased(item) and len(drawn(item)["means"]) == 50
    assert "All are drawn as for Viewers without Anti-Aliasing" in viewport.problems()[""]
    numbers = np.arange(50)
    others = numbers < 30 if not into_smooth else numbers >= 20
    choose(blender, item, numbers[others])
    blender.ops.mesh.delete(type="VERT")
    blender.ops.object.mode_set(mode="OBJECT")
    assert file_is_antialiased(item) and len(drawn(item)["means"]) == 20
    assert not viewport.problems()


def test_untouched_gaussians_are_drawn_from_their_file(background) -> None:
    from roigs_addon.scene import edits

    assert edits.file_of(background) == background.roigs.ply
    background.location.x = 3.0
    assert edits.file_of(background) == background.roigs.ply


def test_deleted_gaussians_are_not_drawn(blender: ModuleType, background) -> None:
    drawn(background)
    choose(blender, background, range(10))
    blender.ops.mesh.delete(type="VERT")
    blender.context.view_layer.update()
    assert_rows(drawn(background), slice(None))  # until edit mode is left
    blender.ops.object.mode_set(mode="OBJECT")
    assert_rows(drawn(background), slice(10, None))
    choose(blender, background, range(20))
    assert_rows(drawn(background), slice(10, None))
    blender.ops.mesh.delete(type="VERT")
    blender.ops.object.mode_set(mode="OBJECT")
    from roigs_addon.viewport.objects import marked

    assert not marked([background])


def test_gaussians_are_faint_in_edit_mode(blender: ModuleType, background) -> None:
    from roigs_addon.viewport.objects import are_edited

    assert not are_edited(blender.context)
    choose(blender, background, [0])
    assert are_edited(blender.context)
    blender.ops.object.mode_set(mode="OBJECT")
    blender.ops.mesh.primitive_cube_add()
    blender.ops.object.mode_set(mode="EDIT")
    assert not are_edited(blender.context)
    blender.ops.object.mode_set(mode="OBJECT")


def test_hidden_gaussians_come_back(blender: ModuleType, background) -> None:
    drawn(background)
    choose(blender, background, [3, 4])
    blender.ops.mesh.hide()
    blender.ops.object.mode_set(mode="OBJECT")
    assert_rows(drawn(background), np.setdiff1d(np.arange(30), [3, 4]))
    blender.ops.object.mode_set(mode="EDIT")
    blender.ops.mesh.reveal()
    blender.ops.object.mode_set(mode="OBJECT")
    from roigs_addon.scene import edits

    assert edits.file_of(background) == background.roigs.ply


def test_moved_gaussians_are_drawn_where_they_are(blender: ModuleType, background) -> None:
    before = drawn(background)["means"]
    choose(blender, background, [7])
    blender.ops.transform.translate(value=(1, 2, 3))
    blender.ops.object.mode_set(mode="OBJECT")
    after = drawn(background)["means"]
    assert np.linalg.norm(after[7] - before[7]) == pytest.approx(np.sqrt(14), abs=1e-4)
    np.testing.assert_array_equal(np.delete(after, 7, axis=0), np.delete(before, 7, axis=0))


def test_edits_are_saved_with_the_file(blender: ModuleType, background, tmp_path: Path) -> None:
    choose(blender, background, range(25))
    blender.ops.mesh.delete(type="VERT")
    blender.ops.object.mode_set(mode="OBJECT")
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "edited.blend"))
    blender.ops.wm.open_mainfile(filepath=str(tmp_path / "edited.blend"))
    assert_rows(drawn(blender.data.objects["Background"]), slice(25, None))


def test_a_file_saved_in_edit_mode_shows_its_edits(
    blender: ModuleType, background, tmp_path: Path
) -> None:
    """Also rendered by `blender -b`, where nobody leaves edit mode."""
    choose(blender, background, range(25))
    blender.ops.mesh.delete(type="VERT")
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "edited.blend"))
    blender.ops.wm.open_mainfile(filepath=str(tmp_path / "edited.blend"))
    item = blender.data.objects["Background"]
    assert item.mode == "EDIT"
    assert_rows(drawn(item), slice(25, None))


def test_copies_have_edits_of_their_own(blender: ModuleType, background) -> None:
    blender.ops.object.duplicate()
    copy = blender.context.active_object
    choose(blender, copy, range(5))
    blender.ops.mesh.delete(type="VERT")
    blender.ops.object.mode_set(mode="OBJECT")
    assert len(drawn(copy)["means"]) == 25 and len(drawn(background)["means"]) == 30


def test_parts_stay_gaussians(blender: ModuleType, background) -> None:
    """Separate, and join again."""
    choose(blender, background, range(12))
    blender.ops.mesh.separate(type="SELECTED")
    blender.ops.object.mode_set(mode="OBJECT")
    part = next(i for i in blender.context.selected_objects if i != background)
    assert_rows(drawn(part), slice(0, 12))
    assert_rows(drawn(background), slice(12, None))
    blender.ops.object.join()
    assert_rows(drawn(background), np.r_[12:30, 0:12])


def test_new_results_are_drawn_whole(blender: ModuleType, background) -> None:
    choose(blender, background, range(10))
    blender.ops.mesh.delete(type="VERT")
    blender.ops.object.mode_set(mode="OBJECT")
    blender.ops.roigs.load_results()
    assert_rows(drawn(background), slice(None))


def test_new_results_end_edit_mode(blender: ModuleType, background) -> None:
    """Otherwise Blender would write the old points into the new mesh."""
    choose(blender, background, range(10))
    blender.ops.mesh.delete(type="VERT")
    blender.ops.roigs.load_results()
    assert background.mode == "OBJECT"
    assert_rows(drawn(background), slice(None))


def test_selecting_something_else_ends_edit_mode(blender: ModuleType, background) -> None:
    """Otherwise the edits would not be drawn, and the next Tab would edit the box."""
    choose(blender, background, range(10))
    blender.ops.mesh.delete(type="VERT")
    blender.ops.roigs.select_roi(name="thing")
    assert background.mode == "OBJECT"
    assert_rows(drawn(background), slice(10, None))


def test_new_results_leave_edited_copies_alone(blender: ModuleType, background) -> None:
    """Such a copy, or a part that was separated, is not what was trained."""
    blender.ops.object.duplicate()
    part = blender.context.active_object
    cut(blender, part, range(5))
    blender.ops.roigs.load_results()
    assert_rows(drawn(part), slice(5, None))
    assert_rows(drawn(background), slice(None))


def test_new_results_are_shown_by_linked_copies(blender: ModuleType, background) -> None:
    blender.ops.object.duplicate(linked=True)
    copy = blender.context.active_object
    cut(blender, copy, range(5))
    blender.ops.roigs.load_results()
    assert copy.data == background.data
    assert_rows(drawn(copy), slice(None))


def test_nothing_is_drawn_when_all_is_hidden(blender: ModuleType, background) -> None:
    choose(blender, background, range(30))
    blender.ops.mesh.hide()
    blender.ops.object.mode_set(mode="OBJECT")
    from roigs_addon.viewport.objects import marked

    assert not marked([background])


def test_joined_points_of_other_meshes_are_no_gaussians(blender: ModuleType, background) -> None:
    """They have no shape: they would be drawn as opaque specks."""
    blender.ops.mesh.primitive_cube_add()
    background.select_set(True)
    blender.context.view_layer.objects.active = background
    blender.ops.object.join()
    assert len(background.data.vertices) == 38
    assert_rows(drawn(background), slice(None))


def test_each_problem_stays_until_it_is_solved(blender: ModuleType, background) -> None:
    from roigs_addon import viewport
    from roigs_addon.scene import edits
    from roigs_addon.viewport.objects import marked

    background.data.attributes.remove(background.data.attributes["scale"])
    cut(blender, background, range(5))
    for item in blender.context.scene.objects:
        edits.look_again(item)
    marked(blender.context.scene.objects)
    assert "lack attributes" in viewport.problems()[""]
    blender.data.objects.remove(background)
    assert not viewport.problems()


@pytest.mark.parametrize("way", ["apply", "edit mode"])
def test_what_turns_all_points_turns_their_shapes(
    blender: ModuleType, background, tmp_path: Path, way: str
) -> None:
    """As before Object > Apply, and as if the object had been scaled instead of its points."""
    from mathutils import Matrix

    from roigs_addon.viewport.objects import marked

    background.matrix_basis = before = Matrix.LocRotScale((1, 2, 3), None, (-1, 2, 2)) @ (
        Matrix.Rotation(0.7, 4, "X")
    )
    blender.context.view_layer.update()
    if way == "apply":
        expected = background.matrix_world.copy()
        blender.ops.object.transform_apply(location=True, rotation=True, scale=True)
        assert not np.allclose(background.matrix_world, expected)
    else:
        expected = background.matrix_world @ before
        choose(blender, background, range(30))
        blender.ops.object.mode_set(mode="OBJECT")
        background.data.transform(before)
    cut(blender, background, range(5))
    background.data.vertices[0].co.x += 9
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "applied.blend"))
    blender.ops.wm.open_mainfile(filepath=str(tmp_path / "applied.blend"))
    (found,) = marked([blender.data.objects["Background"]])
    np.testing.assert_allclose(found.matrix, expected, atol=1e-4)
    got = read_ply(found.file.path)
    for name, values in random_arrays(30, seed=4).items():
        rows = slice(6 if name == "means" else 5, None)
        if name != "quats":
            np.testing.assert_allclose(got[name][-len(values[rows]) :], values[rows], atol=1e-4)


def test_points_without_shapes_are_drawn_as_they_were(blender: ModuleType, background) -> None:
    from roigs_addon import viewport
    from roigs_addon.scene import edits

    background.data.attributes.remove(background.data.attributes["scale"])
    background.data.vertices[0].co.x += 1
    edits.look_again(background)
    assert_rows(drawn(background), slice(None))
    assert "lack attributes" in viewport.problems()[""]


def test_only_the_last_edit_takes_space(blender: ModuleType, background) -> None:
    from roigs_addon.scene import edits

    for _ in range(3):
        choose(blender, background, [0])
        blender.ops.mesh.delete(type="VERT")
        blender.ops.object.mode_set(mode="OBJECT")
        drawn(background)
    assert len(list(Path(blender.app.tempdir).glob(f"{edits.PREFIX}*"))) == 1
