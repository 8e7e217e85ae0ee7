"""Results that a later training has replaced: they stay in sight, come back, and can be deleted."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.results import PARTS, files, set_aside

pytestmark = pytest.mark.blender


def test_what_is_shown_stays_when_a_new_training_starts(blender: ModuleType, run) -> None:
    from roigs_addon.facts import run_facts
    from roigs_addon.jobs import current

    scene, folder = run
    blender.ops.roigs.load_results()
    place = set_aside(folder)
    assert run_facts.lost_splats(scene)
    for listener in current.on_end:  # the training was stopped
        listener()
    assert not run_facts.lost_splats(scene)
    assert all(place in file.parents for file in files(scene))


def test_without_a_result_the_last_one_is_loaded(blender: ModuleType, run) -> None:
    """As after the next day's start: nothing but the earlier result is there."""
    scene, folder = run
    place = set_aside(folder)
    blender.ops.roigs.load_results()
    assert files(scene) == {
        place / part for part in ("background.ply", "rois/thing.ply", "coarse/thing.ply")
    }


def test_results_are_switched(blender: ModuleType, run) -> None:
    bpy, (scene, folder) = blender, run
    older = set_aside(folder)
    for part in PARTS:  # the new result has another box
        source = older / part
        if source.is_dir():
            shutil.copytree(source, folder / part)
            (folder / part / "thing.ply").rename(folder / part / "other.ply")
        else:
            shutil.copy(source, folder / part)
    bpy.ops.roigs.load_results()
    assert {f.name for f in files(scene)} == {"background.ply", "other.ply"}
    bpy.ops.roigs.load_results(earlier=older.name)
    assert {f.name for f in files(scene)} == {"background.ply", "thing.ply"}
    assert all(older in file.parents for file in files(scene))
    bpy.ops.roigs.load_results()
    assert not any(older in file.parents for file in files(scene))
    with pytest.raises(RuntimeError, match="is gone"):
        bpy.ops.roigs.load_results(earlier="none")


def test_copies_follow(blender: ModuleType, run) -> None:
    bpy, (scene, folder) = blender, run
    bpy.ops.roigs.load_results()
    copy = scene.objects["thing Gaussians"].copy()
    scene.collection.objects.link(copy)
    place = set_aside(folder)
    bpy.ops.roigs.load_results()
    assert Path(copy.roigs.ply) == place / "rois" / "thing.ply"


def test_an_earlier_result_is_deleted(blender: ModuleType, run) -> None:
    bpy, (_, folder) = blender, run
    place = set_aside(folder)
    (folder / "earlier" / "mine").mkdir()
    bpy.ops.roigs.delete_result(earlier=place.name)
    assert not place.exists() and (folder / "earlier" / "mine").is_dir()
    with pytest.raises(RuntimeError, match="deleted already"):
        bpy.ops.roigs.delete_result(earlier="../earlier")
    assert not bpy.ops.roigs.load_results.poll()


def test_the_panel_lists_them(blender: ModuleType, run) -> None:
    from roigs_addon.facts import run_facts
    from roigs_addon.ui.result import ResultPanel
    from tests.addon.panels import said

    scene, folder = run
    assert not any("Earlier results" in text for text in said(blender, ResultPanel))
    report = {"test_views": ["1", "2"], "rois": [{"rows": [{"roi_psnr": 9}, {"roi_psnr": 27.42}]}]}
    (folder / "report.json").write_text(json.dumps(report))
    settings = {"scene": "garden", "preset": "standard", "max_side": 960}
    (folder / "settings.json").write_text(json.dumps(settings))
    texts = " ".join(said(blender, ResultPanel))
    assert "Last result: Standard, 960 px, 27.4 dB on 2 test photos" in texts
    place = set_aside(folder)
    texts = said(blender, ResultPanel)
    assert "Earlier results, 1 MB in total" in texts
    assert "Standard, 960 px" in texts
    assert "27.4 dB at 960 px on 2 test photos, " in " ".join(texts)
    (found,) = run_facts.earlier(scene)
    assert found.folder == place
    assert found.size == sum(f.stat().st_size for f in place.rglob("*.*"))
