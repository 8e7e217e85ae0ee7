"""A whole run on a small synthetic scene: both strategies, stopping, resuming, refusing."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from roigs_engine.context import Context
from roigs_engine.errors import RunFolderError, Stopped
from roigs_engine.formats.events import Event, Message
from roigs_engine.formats.run_files import is_own
from roigs_engine.formats.splat_ply import target_of
from roigs_engine.formats.stage_list import read_stage_list
from roigs_engine.model.gaussians import NAMES, Gaussians
from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.model.scene import SfmScene
from roigs_engine.run.definition import Run, define_run
from roigs_engine.run.executor import Executor
from roigs_engine.run.stage_folder import StageFolder, StageResult
from roigs_engine.run.stages import PhotoSets, scene_stage
from roigs_engine.run.strategies import plan_run
from roigs_engine.training import metrics
from roigs_engine.training.mechanisms.background_points import BackgroundPoints
from roigs_engine.training.stage_data import StageData
from tests.engine.runs import finished, opened, plys, stage_of, tiny, train, train_run
from tests.engine.synthetic_scene import BOX, make_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


@pytest.mark.parametrize("strategy", ["joint", "independent"])
def test_a_run_writes_its_result_and_every_stage(
    scene: SfmScene, tmp_path: Path, strategy: str
) -> None:
    run = define_run(tmp_path, scene, [BOX], tiny(strategy))
    trained = train_run(run, ["full-scene", "full-object"])
    stage = "joint" if strategy == "joint" else "object-thing"
    expected = {"full-scene", "full-object-thing", "scene", stage}
    assert finished(tmp_path) == expected
    result = Gaussians.load_ply(tmp_path / "result.ply")
    for name in NAMES:
        assert torch.equal(getattr(result, name), getattr(trained[-1].gaussians, name))
    part = Gaussians.load_ply(tmp_path / "rois" / "thing.ply")
    assert len(part) == int(result.in_box(BOX).sum()) > 0
    assert len({model.name for model in trained}) == len(trained)
    assert not set(run.test) & {image.name for image in run.train_scene.images}
    for path in tmp_path.rglob("*.ply"):  # 3DGS and the paper draw without anti-aliasing
        is_plain = strategy == "independent" or path.parent.name.startswith("full-scene")
        assert target_of(path).antialiased != is_plain


def test_the_scene_learns_from_smaller_photos_and_the_boxes_from_whole_ones(
    scene: SfmScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes: dict[str, set[int]] = {}
    train_stage = StageFolder.train

    def watched(folder: StageFolder, start: Any, data: StageData, *arguments: Any) -> StageResult:
        sizes[folder.name] = {image.camera.width for image in data.images}
        return train_stage(folder, start, data, *arguments)

    monkeypatch.setattr(StageFolder, "train", watched)
    train(tmp_path, scene, [BOX], tiny("joint", scene_scale=0.5))
    (width,) = sizes["joint"]
    assert sizes["scene"] == {round(width / 2)}


def test_a_photo_that_does_not_fit_is_named_by_one_stage(
    scene: SfmScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in {"VISITS": 1, "DEVIATIONS": -9.0, "TIMES": 1.0, "NAMED": 99}.items():
        monkeypatch.setattr(metrics, name, value)  # half of the photos stand out
    events: list[Event] = []
    train(tmp_path, scene, [BOX], tiny("joint"), context=Context(emit=events.append))
    said = [e.text for e in events if isinstance(e, Message) and "fit worse" in e.text]
    photos = [re.findall("'(.+?)'", text) for text in said]
    assert [text.partition(":")[0] for text in said] == ["scene", "joint"]
    assert all(photos) and not set(photos[0]) & set(photos[1])


def test_the_other_strategy_stands_in_the_same_table(scene: SfmScene, tmp_path: Path) -> None:
    trained = train(tmp_path, scene, [BOX], tiny("joint"), ["independent"])
    names = [model.name for model in trained]
    ours = ["Scene-GS (joint)", "Joint"]
    theirs = ["Scene-GS", "Object-GS", "Composition", "Composition, refined"]
    assert names == theirs + ours
    assert (tmp_path / "compare-independent" / "result.ply").exists()


def test_a_refined_composition_takes_no_more_steps_and_no_more_gaussians(
    scene: SfmScene, tmp_path: Path
) -> None:
    plain = train(tmp_path / "plain", scene, [BOX], tiny("independent"))
    config = tiny("independent", refine_share=0.2)
    rows = train(tmp_path / "refined", scene, [BOX], config)
    steps = {
        name: json.loads((folder / "stage.json").read_text())["steps"]
        for name, folder in read_stage_list(tmp_path / "refined").items()
    }
    assert steps == {"scene": 12, "object-thing": 14, "refine": 4}
    assert [row.name for row in rows[:-1]] == [row.name for row in plain]
    composed, refined = (row.gaussians for row in rows[-2:])
    assert 0 < len(refined) <= len(composed)
    assert not torch.equal(refined.sh, composed.sh)
    assert rows[-1].seconds > rows[-2].seconds


def test_a_stopped_run_goes_on_to_the_same_bytes(scene: SfmScene, tmp_path: Path) -> None:
    train(tmp_path / "whole", scene, [BOX], tiny("independent"))
    asked = 0

    def every_eleventh() -> bool:
        nonlocal asked
        asked += 1
        return asked % 11 == 0

    stops = 0
    while True:
        context = Context(should_stop=every_eleventh)
        try:
            train(tmp_path / "cut", scene, [BOX], tiny("independent"), context=context)
            break
        except Stopped:
            stops += 1
    assert stops >= 3
    assert plys(tmp_path / "cut") == plys(tmp_path / "whole")
    assert not list(tmp_path.rglob("checkpoint*"))


def test_scene_stage_does_not_see_reserved_photos(scene: SfmScene, tmp_path: Path) -> None:
    photos = PhotoSets(define_run(tmp_path, scene, [BOX], tiny("independent", kept_share=0.5)))
    selected = photos.selection(BOX).names
    seen = {image.name for image in scene_stage(photos).images}
    assert seen & set(selected) == set(selected[1::2])
    assert seen | set(selected) == {image.name for image in photos.images}


def test_other_settings_are_refused_with_the_difference(scene: SfmScene, tmp_path: Path) -> None:
    opened(tmp_path, scene, [BOX], tiny("joint"))
    before = (tmp_path / "manifest.json").read_bytes()
    with pytest.raises(RunFolderError, match=r"seed was 0, now 1"):
        opened(tmp_path, scene, [BOX], tiny("joint", seed=1))
    assert (tmp_path / "manifest.json").read_bytes() == before


@pytest.mark.parametrize("init", ["points", "box"])
def test_ablations_of_the_start(scene: SfmScene, tmp_path: Path, init: str) -> None:
    config = tiny("independent", roi_init=init)
    config = replace(config, roi=replace(config.roi, steps=1))
    run = define_run(tmp_path, scene, [BOX], config)
    executor = Executor(run)
    base, stage = plan_run(run).stages
    wanted = len(scene.points)
    if init == "box":
        wanted = int(executor.result(base).gaussians.in_box(BOX).sum())
    assert len(executor.result(stage).gaussians) == wanted


def test_the_scene_starts_with_background_points_where_it_has_no_points(
    scene: SfmScene, tmp_path: Path
) -> None:
    few = scene.points[:, 0] < scene.points[:, 0].mean()
    rows = few.cumsum() - 1
    images = tuple(
        replace(image, point_indices=rows[image.point_indices[few[image.point_indices]]])
        for image in scene.images
    )
    half = replace(scene, images=images, points=scene.points[few], colors=scene.colors[few])
    counts = []
    for cells in (0, 16):
        config = tiny("joint")
        stage = config.scene.using(BackgroundPoints(cells=cells)) if cells else config.scene
        config = replace(config, scene=replace(stage, steps=1))
        run = define_run(tmp_path / str(cells), half, [BOX], config)
        base, _ = plan_run(run).stages
        counts.append(len(Executor(run).result(base).gaussians))
    assert counts[0] == len(half.points) < counts[1]


def stage_names(run: Run, *compare: str) -> list[str]:
    return [stage.name for stage in plan_run(run, compare).stages]


def test_a_plan_is_made_without_training(scene: SfmScene, tmp_path: Path) -> None:
    run = define_run(tmp_path / "run", scene, [BOX], tiny("joint"))
    assert stage_names(run) == ["scene", "joint"]
    assert stage_names(run, "full-scene", "full-object") == [
        *("scene", "joint", "full-scene", "full-object-thing")
    ]
    assert stage_names(run, "independent") == [
        *("scene", "joint"),
        *(f"compare-independent/{name}" for name in ("scene", "object-thing", "refine")),
    ]
    refined = define_run(tmp_path / "run", scene, [BOX], tiny("independent", refine_share=0.2))
    assert stage_names(refined) == ["scene", "object-thing", "refine"]
    assert not (tmp_path / "run").exists()


def test_fingerprints_follow_from_the_plan_alone(scene: SfmScene, tmp_path: Path) -> None:
    def fingerprints(**changes: Any) -> dict[str, str]:
        run = define_run(tmp_path, scene, [BOX], tiny("independent", **changes))
        return {stage.name: stage.fingerprint for stage in plan_run(run).stages}

    first, again = fingerprints(), fingerprints()
    assert first == again
    assert all(first[name] != value for name, value in fingerprints(seed=1).items())
    longer = replace(tiny("independent").roi, steps=31)
    changed = fingerprints(roi=longer)
    assert changed["scene"] == first["scene"]
    assert changed["object-thing"] != first["object-thing"]


@pytest.mark.parametrize("strategy", ["joint", "independent"])
def test_every_stage_is_made_and_read_at_most_once(
    scene: SfmScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, strategy: str
) -> None:
    trained: list[str] = []
    read: list[str] = []
    train_stage, load_ply = StageFolder.train, Gaussians.load_ply

    def counted_train(folder: StageFolder, *arguments: Any) -> StageResult:
        trained.append(folder.name)
        return train_stage(folder, *arguments)

    def counted_load(path: Path, frame: LocalFrame) -> Gaussians:
        read.append(path.parent.name)
        return load_ply(path, frame)

    monkeypatch.setattr(StageFolder, "train", counted_train)
    monkeypatch.setattr(Gaussians, "load_ply", counted_load)
    other = "independent" if strategy == "joint" else "joint"
    compare = ["full-scene", "full-object", other]
    run = define_run(tmp_path, scene, [BOX], tiny(strategy, refine_share=0.2))
    names = stage_names(run, *compare)
    train_run(run, compare)
    same = {"full-object-thing"}  # as `full-scene`: every photo sees the box
    assert set(trained) == set(names) - same and len(set(trained)) == len(trained)
    assert set(read) <= {stage_of(tmp_path, "full-scene").name}  # the others are in memory
    read.clear()
    events: list[Event] = []
    train_run(run, compare, Context(emit=events.append))
    assert len(set(trained)) == len(trained)
    assert sorted(read) == sorted(stage_of(tmp_path, name).name for name in names)
    done = [
        e.text
        for e in events
        if isinstance(e, Message) and "finished in an earlier training" in e.text
    ]
    assert len(done) == len(names)
    assert all(is_own(path.name) for path in tmp_path.iterdir())
