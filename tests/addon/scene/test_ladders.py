"""The files that stand for an object, by `levels.json` in its run folder."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.levels_cases import FAR, NEAR, age, make_levels

pytestmark = [pytest.mark.blender, pytest.mark.exact_look]

CLIP = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 0]])
POSE = np.eye(4)
POSE[2, 3] = 4.0


@pytest.fixture
def levelled(blender: ModuleType, run):
    """A scene with a result in levels of detail, of which views show the last, and its folder."""
    scene, folder = run
    make_levels(folder, rate=FAR)
    blender.ops.roigs.load_results()
    return scene, folder


def files(scene, name: str, **how: bool) -> list[str]:
    """The files of an object's levels, relative to the run folder."""
    from roigs_addon.scene import ladders

    detail = ladders.of(scene.objects[name], scene, **how)
    folder = Path(scene.roigs.run_dir)
    return [Path(f).relative_to(folder).as_posix() for f in detail.files] if detail else []


def drawn(scene, name: str = "Background") -> dict[int, float]:
    from roigs_addon.scene import ladders

    return ladders.of(scene.objects[name], scene).shown(np.eye(4), CLIP @ POSE, 100.0)


def test_levels_of_the_last_result(levelled) -> None:
    scene, _ = levelled
    assert files(scene, "Background") == [
        "background.ply",
        "levels/1/background.ply",
        "levels/2/background.ply",
    ]
    assert files(scene, "thing Gaussians")[1:] == [
        "levels/1/rois/thing.ply",
        "levels/2/rois/thing.ply",
    ]
    assert not files(scene, "thing first pass")
    assert drawn(scene) == {2: 1.0}


def test_it_is_read_once_and_again_when_it_changes(
    levelled, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.scene import ladders

    scene, folder = levelled
    assert drawn(scene) == {2: 1.0}
    read, original = [], ladders._read
    monkeypatch.setattr(ladders, "_read", lambda *given: read.append(1) or original(*given))
    drawn(scene)
    assert not read
    make_levels(folder, rate=NEAR)
    assert drawn(scene) == drawn(scene) == {0: 1.0} and len(read) == 1


def test_older_than_the_result(levelled) -> None:
    from roigs_addon.scene import ladders

    scene, folder = levelled
    assert not ladders.problem(scene)
    age(folder / "background.ply", 60)
    assert not files(scene, "Background") and files(scene, "thing Gaussians")
    assert ladders.problem(scene) == ladders.STALE
    age(folder / "levels.json", 120)
    assert files(scene, "Background") and not ladders.problem(scene)


def test_damage_is_one_line(levelled) -> None:
    from roigs_addon.scene import ladders

    scene, folder = levelled
    (folder / "levels.json").write_text("{")
    assert not files(scene, "Background")
    assert "levels.json" in ladders.problem(scene) and "\n" not in ladders.problem(scene)
    (folder / "levels.json").unlink()
    assert not files(scene, "Background") and not ladders.problem(scene)


def test_with_a_level_missing_the_object_is_whole(blender: ModuleType, levelled) -> None:
    from roigs_addon.scene import ladders
    from roigs_addon.viewport.objects import marked

    scene, folder = levelled
    names = ("Background", "thing Gaussians")

    def levels() -> list[bool]:
        found = marked([scene.objects[name] for name in names], scene=scene)
        return [item.levels is not None for item in found]

    assert levels() == [True, True]
    (folder / "levels" / "2" / "background.ply").unlink()
    assert levels() == [False, True]
    told = ladders.problem(scene)
    assert "is missing" in told and "background.ply" in told and "Make the levels again" in told


def test_edited_gaussians_are_whole(blender: ModuleType, levelled) -> None:
    scene, _ = levelled
    item = scene.objects["Background"]
    item.data.vertices[0].co.x += 1
    blender.context.view_layer.update()
    from roigs_addon.scene import edits

    edits.look_again(item)
    assert not files(scene, "Background") and files(scene, "thing Gaussians")


def test_off_full_and_in_edit_mode(blender: ModuleType, levelled) -> None:
    scene, folder = levelled
    scene.roigs.use_levels = False
    assert drawn(scene) == {0: 1.0}
    scene.roigs.use_levels = True
    blender.ops.roigs.set_detail(name="Background")
    assert drawn(scene) == {0: 1.0} and drawn(scene, "thing Gaussians") == {2: 1.0}
    blender.ops.wm.save_as_mainfile(filepath=str(folder / "levels.blend"))
    blender.ops.wm.open_mainfile(filepath=str(folder / "levels.blend"))
    scene = blender.context.scene
    assert drawn(scene) == {0: 1.0} and drawn(scene, "thing Gaussians") == {2: 1.0}
    blender.ops.roigs.set_detail(name="Background", auto=True)
    assert drawn(scene) == {2: 1.0}
    blender.ops.roigs.select_gaussians(name="Background")
    blender.ops.object.mode_set(mode="EDIT")
    assert drawn(scene) == {0: 1.0}
    blender.ops.object.mode_set(mode="OBJECT")
    assert drawn(scene) == {2: 1.0}


def test_auto_fine_and_coarse(blender: ModuleType, levelled) -> None:
    scene, _ = levelled
    item = scene.objects["thing Gaussians"]
    set_detail = blender.ops.roigs.set_detail
    for auto in (False, True):
        set_detail(roi="thing", fine=False)
        assert item.hide_viewport
        set_detail(roi="thing", auto=auto)
        assert not item.hide_viewport and item.roigs.whole != auto


def test_fine_does_not_keep_levels_away_that_come_later(blender: ModuleType, run) -> None:
    scene, folder = run
    blender.ops.roigs.load_results()
    blender.ops.roigs.set_detail(roi="thing", fine=False)
    blender.ops.roigs.set_detail(roi="thing", fine=True)
    make_levels(folder, rate=FAR)
    assert drawn(scene, "thing Gaussians") == {2: 1.0}


def test_quality_and_scale_move_the_switch(levelled) -> None:
    from roigs_addon.scene import ladders

    scene, folder = levelled
    # 100 pixels per unit at a depth of 1, seen from a distance of 5: 20 pixels per unit.
    make_levels(folder, rate=20.0 * 3, probes=np.array([[0.0, 0, 1]]))
    detail = ladders.of(scene.objects["Background"], scene)
    assert detail.shown(np.eye(4), CLIP @ POSE, 100.0) == {1: 1.0}
    larger, nothing = np.diag([2, 2, 2, 1.0]), np.zeros((4, 4))
    assert detail.shown(larger, CLIP @ POSE, 100.0) == {0: 1.0}
    assert detail.shown(nothing, CLIP @ POSE, 100.0) == {2: 1.0}
    assert detail.shown(larger * np.nan, CLIP @ POSE, 100.0) == {0: 1.0}
    scene.roigs.level_quality = 2.0
    assert drawn(scene) == {0: 1.0}
    scene.roigs.level_quality = 0.5
    assert drawn(scene) == {2: 1.0}


def test_an_earlier_result_has_its_own(blender: ModuleType, two) -> None:
    scene, folder, older = two
    make_levels(older, rate=FAR)
    assert not files(scene, "Background")
    blender.ops.roigs.compare_results()
    assert (
        files(scene, "Background")[0] == (older / "background.ply").relative_to(folder).as_posix()
    )
