"""The panel says what Train would do, before the click."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.scenes import add_box, listed_stage, record, status

pytestmark = pytest.mark.blender
PHOTOS = [f"photo {number}.png" for number in range(8)]


@pytest.fixture
def trained(blender: ModuleType, run):
    """A scene whose settings are those of the made-up results in its run folder."""
    scene, folder = run
    scene.roigs.steps_factor, scene.roigs.max_side = 1.0, 32
    write(scene, folder)
    return scene, folder


def write(scene, folder: Path, **manual: list[str]) -> None:
    """The files in which the engine says what it has trained."""
    from roigs_addon.jobs import options_files
    from roigs_addon.scene import lookup

    boxes = lookup.rois(scene)
    path = options_files.write_train_options(scene, boxes, 0.0)
    values = json.loads(path.read_text("utf-8"))
    (folder / "settings.json").write_text(json.dumps(values), encoding="utf-8")
    config = {"strategy": "joint", "selection": {"method": "coverage"}}
    contents = dict.fromkeys(PHOTOS, "hash")
    manifest = {"config": config, "contents": contents, "manual": manual}
    manifest["rois"] = [record(box, scene) for box in boxes]
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    for name, seconds in (("scene", 240.0), ("joint", 360.0)):
        place = listed_stage(folder, name)
        (place / "stage.json").write_text(json.dumps({"seconds": seconds}))


def words(scene) -> str:
    from roigs_addon.facts import outdated

    return outdated.in_words(scene, status(scene))


def test_what_is_trained_says_so(blender: ModuleType, trained) -> None:
    from roigs_addon.ui.train import TrainPanel
    from tests.addon.panels import said

    scene, _ = trained
    assert words(scene) == ""
    assert any(text.startswith("Trained: ") for text in said(blender, TrainPanel))
    scene.roigs.max_side = 16
    texts = " ".join(said(blender, TrainPanel))
    assert "Trained: " not in texts and "Now: 16 px" in texts


def test_another_photo_size(trained) -> None:
    scene, _ = trained
    scene.roigs.max_side = 16
    assert words(scene) == ("Last training: 32 px. Now: 16 px. Train starts again (about 2 min)")
    scene.roigs.max_side = 640
    most = words(scene)  # the photos are no larger than that
    scene.roigs.max_side = 641
    assert words(scene) == most


def test_several_settings(trained) -> None:
    scene, _ = trained
    scene.roigs.preset, scene.roigs.seed = "standard", 3
    assert words(scene) == (
        "Last training: Draft, seed 0. Now: Standard, seed 3. Train starts again (about 17 min)"
    )


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("strategy", "independent", "boxes one by one"),
        ("made_for", "eevee", "made for Blender 5.3, EEVEE"),
        ("steps_factor", 2.0, "2 x steps"),
        ("test_every", 4, "test photos: 1 in 4"),
        ("method", "fvs", "method fvs"),
        ("count", 3, "3 photos a box"),
    ],
)
def test_every_setting_that_decides(trained, name: str, value: object, expected: str) -> None:
    scene, _ = trained
    setattr(scene.roigs, name, value)
    assert expected in words(scene)
    assert ("Train repeats the boxes (about 6 min)" in words(scene)) == (
        name in ("method", "count")
    )


def test_a_training_by_an_earlier_version(trained) -> None:
    scene, folder = trained
    manifest = json.loads((folder / "manifest.json").read_text("utf-8"))
    manifest["config"] |= {"scene": {"steps": 2000}, "roi": {"steps": 4000, "made_for": "viewers"}}
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    assert words(scene) == (
        "Trained by an earlier version with other preset settings. Train starts again (about 8 min)"
    )
    manifest["config"]["roi"]["steps"] = 3000
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    assert words(scene) == ""


def test_a_deleted_photo(blender: ModuleType, trained) -> None:
    scene, _ = trained
    blender.data.objects.remove(scene.objects["photo 3.png"])
    assert "Last training: all photos. Now: without photo 3.png" in words(scene)


def test_boxes_and_lists(blender: ModuleType, trained) -> None:
    from roigs_addon.scene import lookup, rois

    scene, folder = trained
    blender.ops.roigs.edit_selection(action="ADD", photo="photo 2.png")
    assert words(scene).startswith("Photo list changed since training: thing. Train repeats")
    write(scene, folder, thing=["photo 2.png"])
    assert words(scene) == ""
    add_box(blender, "jug", (-0.5, -0.5, -0.5), (0.0, 0.1, 0.2))
    assert words(scene).startswith("Changed since training: jug. Train repeats the boxes (about 6")
    write(scene, folder, thing=["photo 2.png"])
    blender.data.objects.remove(scene.objects["jug"])
    assert words(scene).startswith("Changed since training: jug (removed)")
    assert rois.trained_names(scene, {}) == {} and len(lookup.rois(scene)) == 1


def test_a_renamed_box_is_trained(blender: ModuleType, trained) -> None:
    from roigs_addon.jobs import train_job
    from roigs_addon.ui.result import ResultPanel
    from roigs_addon.ui.train import TrainPanel
    from tests.addon.panels import said

    scene, folder = trained
    blender.ops.roigs.load_results()
    scene.objects["thing"].name = "pot"
    assert words(scene) == ""
    assert "'pot' was trained as 'thing'" in " ".join(said(blender, TrainPanel))
    assert "pot" in said(blender, ResultPanel) and "thing" not in said(blender, ResultPanel)
    (folder / "result.ply").unlink()
    assert [b.name for b in train_job.boxes_to_resume(scene, status(scene))] == ["pot"]


def test_an_earlier_result_with_these_settings(trained) -> None:
    from tests.addon.results import set_aside

    scene, folder = trained
    set_aside(folder)
    scene.roigs.max_side = 16
    write(scene, folder)
    (folder / "result.ply").touch()
    scene.roigs.max_side = 32
    assert words(scene).endswith(". Train reuses the earlier result where it still fits")


def test_undo_of_a_setting_is_seen(trained) -> None:
    """An artist's bug: undo had set the photo size back, and the panel said 'Trained'."""
    scene, folder = trained
    scene.roigs.max_side = 16
    write(scene, folder)
    assert words(scene) == ""
    scene.roigs.max_side = 32  # as undo does
    assert "Last training: 16 px. Now: 32 px" in words(scene)


def test_a_stopped_training_says_it_too(blender: ModuleType, trained) -> None:
    from roigs_addon.ui.train import TrainPanel
    from tests.addon.panels import said

    scene, folder = trained
    (folder / "result.ply").unlink()
    (listed_stage(folder, "joint") / "checkpoint.bin").touch()
    assert "Stopped during: all boxes" in " ".join(said(blender, TrainPanel))
    assert "Train starts again" not in " ".join(said(blender, TrainPanel))
    scene.roigs.max_side = 16
    texts = " ".join(said(blender, TrainPanel))
    assert "Stopped during: all boxes" in texts and "Train starts again" in texts
