"""Runs that change: other boxes or photos in one folder, photos given, none kept for tests."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roigs_engine.context import Context
from roigs_engine.errors import ConfigError, RunFolderError, Stopped
from roigs_engine.formats.clean_up import removable
from roigs_engine.formats.events import Event, Message, Preview, StageStarted
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import SfmScene
from roigs_engine.run.manifest import check_version, manifest_difference
from roigs_engine.run.stages import PhotoSets
from roigs_engine.selection import METHODS, SelectionConfig, select_cameras
from roigs_engine.selection.manual import load_manual
from tests.engine.runs import (
    SECOND,
    checkpoint_step,
    opened,
    plys,
    production,
    stage_of,
    tiny,
    train,
    train_run,
)
from tests.engine.synthetic_scene import BOX, make_scene

MOVED = OrientedBox.between("thing", [-0.4, -0.6, -0.6], [0.7, 0.6, 0.6])


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


@pytest.fixture(scope="module")
def trained(scene: SfmScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the one box, to copy."""
    folder = tmp_path_factory.mktemp("trained")
    train(folder, scene, [BOX], production())
    return folder


@pytest.fixture(scope="module")
def trained_apart(scene: SfmScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same of the other strategy."""
    folder = tmp_path_factory.mktemp("apart")
    train(folder, scene, [BOX], production("independent"))
    return folder


@pytest.fixture
def run(trained: Path, tmp_path: Path) -> Path:
    """A copy of `trained`."""
    return shutil.copytree(trained, tmp_path / "run")


@pytest.fixture
def run_apart(trained_apart: Path, tmp_path: Path) -> Path:
    """A copy of `trained_apart`."""
    return shutil.copytree(trained_apart, tmp_path / "apart")


def written(folder: Path, name: str) -> tuple[Path, int]:
    """The files that change when a stage is trained."""
    path = stage_of(folder, name) / "stage.json"
    return path, path.stat().st_mtime_ns


def messages(events: list[Event]) -> list[str]:
    return [event.text for event in events if isinstance(event, Message)]


# --- no test photos ---


def test_without_test_photos_all_are_trained_on(scene: SfmScene, run: Path) -> None:
    again = opened(run, scene, [BOX], production())
    assert again.test == () and len(again.train_scene.images) == len(scene.images)
    assert json.loads((run / "split.json").read_text(encoding="utf-8")) == {
        "evaluate_on": "test",
        "test": [],
    }


# --- photos given by the user ---


def test_given_photos_are_used_in_their_order(scene: SfmScene, tmp_path: Path) -> None:
    given = ["007.png", "002.png", "004.png"]
    run = opened(tmp_path, scene, [BOX, SECOND], production(), manual={"thing": given})
    photos = PhotoSets(run)
    chosen = photos.selection(BOX)
    assert (list(chosen.names), chosen.method) == (given, "manual")
    assert list(chosen.scores) == sorted(chosen.scores)
    train_run(run)
    stored = json.loads((tmp_path / "selection" / "thing.json").read_text(encoding="utf-8"))
    assert stored["names"] == given
    assert photos.selection(SECOND).method == "coverage"
    manifest = json.loads((tmp_path / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["manual"] == {"thing": given}
    with pytest.raises(RunFolderError, match="--selection"):
        opened(tmp_path, scene, [BOX, SECOND], production(), manual={"thing": given[:2]})


def test_given_photos_that_cannot_be_used(scene: SfmScene, tmp_path: Path) -> None:
    config = tiny("joint")
    test = opened(tmp_path / "a", scene, [BOX], config).test
    events: list[Event] = []
    known = replace(scene, skipped={"missing on disk": ("gone.png",)})
    there = next(image.name for image in scene.images if image.name not in test)
    given = {"thing": [test[0], there, "gone.png"]}
    run = opened(
        tmp_path / "b", known, [BOX], config, manual=given, context=Context(emit=events.append)
    )
    assert PhotoSets(run).selection(BOX).names == (there,)
    texts = messages(events)
    assert any("held out for the evaluation" in text and test[0] in text for text in texts)
    assert any("cannot be used" in text and "gone.png" in text for text in texts)
    with pytest.raises(ConfigError, match=r"'nothing\.png'"):
        opened(tmp_path / "c", scene, [BOX], config, manual={"thing": ["nothing.png"]})
    with pytest.raises(ConfigError, match="photos selected for box 'thing' cannot be trained on"):
        opened(tmp_path / "d", scene, [BOX], config, manual={"thing": [test[0]]})
    assert not (tmp_path / "c").exists() and not (tmp_path / "d").exists()


def test_selection_files_as_select_writes_them(scene: SfmScene, tmp_path: Path) -> None:
    chosen = select_cameras(scene, BOX, SelectionConfig(method="fvs", count=4))
    (tmp_path / "thing.json").write_text(json.dumps(chosen.to_dict()), encoding="utf-8")
    assert load_manual(tmp_path, [BOX, SECOND]) == {"thing": chosen.names}
    (tmp_path / "thing.json").write_text('{"names": ["a", "b", "a"]}', encoding="utf-8")
    assert load_manual(tmp_path, [BOX]) == {"thing": ("a", "b")}
    with pytest.raises(ConfigError, match=r"second\.json"):
        load_manual(tmp_path, [SECOND])


def test_other_photos_of_the_same_number_are_another_stage(scene: SfmScene, tmp_path: Path) -> None:
    one, other = ["001.png", "002.png"], ["001.png", "003.png"]
    train(tmp_path, scene, [BOX], production(), manual={"thing": one})
    before = stage_of(tmp_path, "joint"), stage_of(tmp_path, "scene")
    train(tmp_path, scene, [BOX], production(), manual={"thing": other}, update=True)
    assert stage_of(tmp_path, "joint") != before[0]
    assert stage_of(tmp_path, "scene") == before[1]


# --- bringing a run up to date ---


@pytest.mark.parametrize("strategy", ["joint", "independent"])
def test_a_moved_box_keeps_the_scene(
    scene: SfmScene, run: Path, run_apart: Path, tmp_path: Path, strategy: str
) -> None:
    config = production(strategy)
    folder, name = (run, "joint") if strategy == "joint" else (run_apart, "object-thing")
    first = plys(folder)
    before = {n: written(folder, n) for n in ("scene", name)}
    train(folder, scene, [MOVED], config, update=True)
    assert written(folder, "scene") == before["scene"]
    assert stage_of(folder, name) != before[name][0].parent
    assert before[name][0].exists()
    # The files of a fresh run.
    train(tmp_path / "fresh", scene, [MOVED], config)
    for path in ("result.ply", "rois/thing.ply"):
        assert (folder / path).read_bytes() == (tmp_path / "fresh" / path).read_bytes()
    # And back: nothing is trained again.
    train(folder, scene, [BOX], config, update=True)
    assert written(folder, name) == before[name]
    again = plys(folder)
    assert {path: again[path] for path in first} == first


def test_a_second_box_keeps_the_scene_and_the_first_object(
    scene: SfmScene, run_apart: Path
) -> None:
    config = production("independent")
    before = [written(run_apart, n) for n in ("scene", "object-thing")]
    train(run_apart, scene, [BOX, SECOND], config, update=True)
    assert [written(run_apart, n) for n in ("scene", "object-thing")] == before
    assert (stage_of(run_apart, "object-second") / "model.ply").exists()
    assert (run_apart / "rois" / "second.ply").exists()
    train(run_apart, scene, [BOX], config, update=True)
    assert not (run_apart / "rois" / "second.ply").exists()


def test_a_box_less_leaves_no_stage_that_clean_does_not_find(
    scene: SfmScene, tmp_path: Path
) -> None:
    config = production("independent")
    train(tmp_path, scene, [BOX, SECOND], config, ["full-scene"])
    before = written(tmp_path, "object-second")
    train(tmp_path, scene, [BOX, SECOND], config)
    assert removable(tmp_path) == []  # a baseline may be asked for again
    train(tmp_path, scene, [BOX], config, update=True)
    assert before[0] in removable(tmp_path)
    train(tmp_path, scene, [BOX, SECOND], config, update=True)
    assert written(tmp_path, "object-second") == before


def test_an_unfinished_stage_is_kept_and_gone_on_with(
    scene: SfmScene, trained: Path, tmp_path: Path
) -> None:
    asked = 0

    def soon() -> bool:
        nonlocal asked
        asked += bool([*tmp_path.glob("stages/scene-*/stage.json")])
        return asked > 25 + len(scene.images)  # the photos are looked at first, twice each

    with pytest.raises(Stopped):
        train(tmp_path, scene, [BOX], production(), context=Context(should_stop=soon))
    kept = stage_of(tmp_path, "joint") / "checkpoint.bin"
    assert kept.exists()
    train(tmp_path, scene, [MOVED], production(), update=True)
    step = checkpoint_step(kept)
    events: list[Event] = []
    train(tmp_path, scene, [BOX], production(), update=True, context=Context(emit=events.append))
    texts = messages(events)
    assert f"joint: resumes at step {step}." in texts
    assert (tmp_path / "result.ply").read_bytes() == (trained / "result.ply").read_bytes()


def test_other_points_are_another_start(scene: SfmScene, run: Path) -> None:
    before = stage_of(run, "scene")
    other = replace(scene, colors=255 - scene.colors)
    with pytest.raises(RunFolderError, match="--update"):
        train(run, other, [BOX], production())
    train(run, other, [BOX], production(), update=True)
    assert stage_of(run, "scene") != before


def test_another_model_of_the_same_photos_is_refused_before_anything_is_written(
    scene: SfmScene, run: Path
) -> None:
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    moved = [
        replace(image, world_to_camera=image.world_to_camera + np.eye(4)[3][:, None] * 0.01)
        for image in scene.images
    ]
    other = replace(scene, images=tuple(moved))
    with pytest.raises(RunFolderError, match=r"model was .* --update"):
        opened(run, other, [BOX], production())
    assert before == {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    opened(run, other, [BOX], production(), update=True)
    assert not (run / "result.ply").exists()
    (former,) = (run / "earlier").iterdir()
    assert {"result.ply", "split.json"} <= {path.name for path in former.iterdir()}


def test_updating_what_fits_changes_nothing(scene: SfmScene, run: Path) -> None:
    train(run, scene, [BOX], production(), update=True)
    assert not (run / "earlier").exists()


@pytest.mark.parametrize("strategy", ["joint", "independent"])
def test_a_renamed_box_is_not_trained_again(scene: SfmScene, tmp_path: Path, strategy: str) -> None:
    config, manual = production(strategy), ["007.png", "002.png", "004.png"]
    train(tmp_path, scene, [BOX, SECOND], config, manual={"thing": manual})
    before = plys(tmp_path)
    events: list[Event] = []
    context, boxes = Context(emit=events.append), [replace(BOX, name="pot"), SECOND]
    train(tmp_path, scene, boxes, config, manual={"pot": manual}, update=True, context=context)
    assert not [event for event in events if isinstance(event, StageStarted)]
    after = plys(tmp_path)
    names = {name: name.replace("s/thing.ply", "s/pot.ply") for name in before}
    names["coarse/thing.ply"] = "coarse/pot.ply"
    assert after == {names[name]: data for name, data in before.items()}
    assert {path.stem for path in (tmp_path / "selection").iterdir()} == {"pot", "second"}
    train(tmp_path, scene, [BOX, SECOND], config, manual={"thing": manual}, update=True)
    assert plys(tmp_path) == before
    assert not [path for path in removable(tmp_path) if path.parent.name == "stages"]


def test_stages_that_are_the_same_are_trained_once(scene: SfmScene, tmp_path: Path) -> None:
    """`full-object-thing` where every photo sees the box; the next engine finds it, too."""
    events: list[Event] = []
    compare = ("full-scene", "full-object")
    train(tmp_path, scene, [BOX], production(), compare, context=Context(emit=events.append))
    started = [event.stage for event in events if isinstance(event, StageStarted)]
    assert sorted(started) == ["full-scene", "joint", "scene"]
    assert stage_of(tmp_path, "full-object-thing") == stage_of(tmp_path, "full-scene")


# --- previews and stops ---


def test_previews_change_nothing(scene: SfmScene, trained: Path, tmp_path: Path) -> None:
    events: list[Event] = []
    context = Context(emit=events.append)
    train(tmp_path, scene, [BOX], production(), preview_seconds=1e-6, context=context)
    shown = [event.path for event in events if isinstance(event, Preview)]
    assert set(shown) == {str(tmp_path / "preview.ply")}
    made = plys(tmp_path)
    assert made.pop("preview.ply")
    assert made == plys(trained)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("tracks", [True, False])
def test_every_selection_stops(scene: SfmScene, method: str, tracks: bool) -> None:
    scene = replace(scene, has_tracks=tracks)
    config = SelectionConfig(method=method, count=9)
    asked = 0

    def count() -> bool:
        nonlocal asked
        asked += 1
        return False

    select_cameras(scene, BOX, config, Context(should_stop=count))
    assert asked >= len(scene.images)
    for stop in (1, asked // 2, asked):
        left = stop

        def soon() -> bool:
            nonlocal left
            left -= 1
            return left == 0

        with pytest.raises(Stopped):
            select_cameras(scene, BOX, config, Context(should_stop=soon))


def test_update_moves_the_results_of_the_other_strategy(scene: SfmScene, run: Path) -> None:
    train(run, scene, [BOX], production(), ["independent"])
    compared = run / "compare-independent" / "result.ply"
    before = compared.read_bytes()
    train(run, scene, [MOVED], production(), update=True)
    assert not compared.exists()  # it belongs to the box before
    train(run, scene, [BOX], production(), update=True)
    assert compared.read_bytes() == before


def test_the_other_strategys_run_and_a_stage_of_its_name_do_not_meet(
    scene: SfmScene, run: Path
) -> None:
    joint, independent = production(), production("independent")
    before, made = written(run, "joint"), plys(run)
    train(run, scene, [BOX], independent, ["joint"], update=True)
    assert (stage_of(run, "compare-joint/joint") / "model.ply").exists()
    train(run, scene, [MOVED], independent, ["joint"], update=True)
    train(run, scene, [BOX], joint, update=True)
    assert written(run, "joint") == before
    assert {name: data for name, data in plys(run).items() if name in made} == made


def test_other_blocks_and_groups_in_words() -> None:
    one, two = {"config": {"blocks": 1}}, {"config": {"blocks": 2}}
    assert manifest_difference(one, two) == "blocks was 1, now 2"
    split = {"groups": [["vase", "tin"], ["clock"]]}
    assert manifest_difference({}, split) == "groups was all boxes, now vase,tin and clock"


def test_other_mechanisms_and_boxes_in_words() -> None:
    def config(**mechanisms: object) -> dict[str, object]:
        return {"config": {"roi": {"mechanisms": mechanisms}}}

    off, on, more = config(), config(decay={"rate": 0.1}), config(decay={"rate": 0.2})
    assert manifest_difference(off, on) == "roi.decay was off, now on"
    assert manifest_difference(on, off) == "roi.decay was on, now off"
    assert manifest_difference(on, more) == "roi.decay.rate was 0.1, now 0.2"
    assert manifest_difference({"config": None}, on) == "config was off, now on"
    one, other = {"rois": [{"name": "pot", "x": 1}]}, {"rois": [{"name": "pot", "x": 2}]}
    two = {"rois": [*one["rois"], {"name": "tin"}, {"name": "vase"}]}
    assert manifest_difference(one, other) == "the box pot changed"
    assert manifest_difference(one, two) == "2 boxes are new, the first is tin"
    assert manifest_difference(two, one) == "2 boxes are gone, the first is tin"
    swapped = {"rois": two["rois"][::-1]}
    assert manifest_difference(two, swapped) == "the order of the boxes changed"


def test_levelled_photos_are_another_run(scene: SfmScene, run: Path) -> None:
    """Without `--update`, nothing of the earlier run is replaced."""
    images = tuple(replace(image, exposure=0.5) for image in scene.images)
    before = plys(run)
    with pytest.raises(RunFolderError, match="photos were not levelled"):
        train(run, replace(scene, images=images), [BOX], production())
    assert plys(run) == before


def test_a_setting_that_is_missing_is_null() -> None:
    """As in the run folder of a version that did not have it."""
    before, now = {"config": {"a": {}, "seed": 1}}, {"config": {"a": {"count": None}, "seed": 1}}
    assert manifest_difference(before, now) == ""
    now["config"]["seed"] = 2
    assert manifest_difference(before, now) == "seed was 1, now 2"


@pytest.mark.parametrize("manifest", [{"icons": []}, {}, {"Config": 1}])
def test_a_manifest_of_somebody_else_is_refused(tmp_path: Path, manifest: dict[str, Any]) -> None:
    """With `update`, a run would move and replace files that only have the names of its own."""
    (tmp_path / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    (tmp_path / "result.ply").write_bytes(b"mine")
    with pytest.raises(RunFolderError, match="is not a manifest of a run"):
        check_version(tmp_path)
