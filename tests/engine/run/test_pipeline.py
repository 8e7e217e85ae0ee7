"""A whole run on a small synthetic scene: both strategies, stopping, going on, refusing."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from roigs_engine.run.pipeline import Run
from roigs_engine.training.stage import Stage, StageResult

from roigs_engine.errors import RunFolderError, Stopped
from roigs_engine.model.gaussians import NAMES, Gaussians
from roigs_engine.model.scene import SfmScene
from roigs_engine.run.config import RunConfig
from roigs_engine.run.presets import preset
from roigs_engine.training.config import TrainConfig
from tests.engine.synthetic_scene import BOX, make_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


def tiny(strategy: str, **changes: object) -> RunConfig:
    config = preset("paper" if strategy == "independent" else "draft")
    quick = {"densify_every": 5, "grad_threshold": 1e-5, "reset_every": 0}
    scene_stage = TrainConfig(steps=20, densify_from=5, densify_until=15, **quick)
    roi_stage = replace(config.roi, steps=30, densify_until=20, **quick)
    selection = replace(config.selection, count=5)
    config = replace(config, scene=scene_stage, roi=roi_stage, selection=selection, test_every=4)
    return replace(config, **changes)


def plys(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*.ply"))}


@pytest.mark.parametrize("strategy", ["joint", "independent"])
def test_a_run_writes_its_result_and_every_stage(
    scene: SfmScene, tmp_path: Path, strategy: str
) -> None:
    run = Run(tmp_path, scene, [BOX], tiny(strategy))
    trained = run.train(["full-scene", "full-object"])
    stage = "joint" if strategy == "joint" else "object-thing"
    expected = {"full-scene", "full-object-thing", "scene", stage}
    assert {p.parent.name for p in tmp_path.rglob("stage.json")} == expected
    result = Gaussians.load_ply(tmp_path / "result.ply")
    for name in NAMES:
        assert torch.equal(getattr(result, name), getattr(trained[-1].gaussians, name))
    part = Gaussians.load_ply(tmp_path / "rois" / "thing.ply")
    assert len(part) == int(result.in_box(BOX).sum()) > 0
    assert len({model.name for model in trained}) == len(trained)
    assert not set(run.test) & {image.name for image in run.train_scene.images}


def test_the_scene_learns_from_smaller_photos_and_the_boxes_from_whole_ones(
    scene: SfmScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes: dict[str, set[int]] = {}
    run_stage = Stage.run

    def watched(stage: Stage, *arguments: Any) -> StageResult:
        sizes[stage.name] = {image.camera.width for image in stage.data.images}
        return run_stage(stage, *arguments)

    monkeypatch.setattr(Stage, "run", watched)
    Run(tmp_path, scene, [BOX], tiny("joint", scene_scale=0.5)).train()
    (width,) = sizes["joint"]
    assert sizes["scene"] == {round(width / 2)}


def test_the_other_strategy_stands_in_the_same_table(scene: SfmScene, tmp_path: Path) -> None:
    trained = Run(tmp_path, scene, [BOX], tiny("joint")).train(["independent"])
    names = [model.name for model in trained]
    ours = ["Scene-GS (joint)", "Joint"]
    theirs = ["Scene-GS", "Object-GS", "Composition", "Composition, refined"]
    assert names == theirs + ours
    assert (tmp_path / "independent" / "result.ply").exists()


def test_a_refined_composition_takes_no_more_steps_and_no_more_gaussians(
    scene: SfmScene, tmp_path: Path
) -> None:
    plain = Run(tmp_path / "plain", scene, [BOX], tiny("independent")).train()
    config = tiny("independent", refine_share=0.2)
    rows = Run(tmp_path / "refined", scene, [BOX], config).train()
    steps = {
        path.parent.name: json.loads(path.read_text())["steps"]
        for path in (tmp_path / "refined").glob("*/stage.json")
    }
    assert steps == {"scene": 20, "object-thing": 24, "seam": 6}
    assert [row.name for row in rows[:-1]] == [row.name for row in plain]
    composed, refined = (row.gaussians for row in rows[-2:])
    assert 0 < len(refined) <= len(composed)
    assert not torch.equal(refined.sh, composed.sh)
    assert rows[-1].evaluated().seconds > rows[-2].evaluated().seconds


def test_a_stopped_run_goes_on_to_the_same_bytes(scene: SfmScene, tmp_path: Path) -> None:
    Run(tmp_path / "whole", scene, [BOX], tiny("independent")).train()
    asked = 0

    def every_eleventh() -> bool:
        nonlocal asked
        asked += 1
        return asked % 11 == 0

    stops = 0
    while True:
        run = Run(tmp_path / "cut", scene, [BOX], tiny("independent"), should_stop=every_eleventh)
        try:
            run.train()
            break
        except Stopped:
            stops += 1
    assert stops >= 3
    assert plys(tmp_path / "cut") == plys(tmp_path / "whole")
    assert not list(tmp_path.rglob("checkpoint*"))


def test_scene_stage_does_not_see_reserved_photos(scene: SfmScene, tmp_path: Path) -> None:
    run = Run(tmp_path, scene, [BOX], tiny("independent", kept_share=0.5))
    selected = run.selection(BOX).names
    seen: list[str] = []
    original = run._train

    def spy(name: str, photos: list[str], *args: object, **options: object) -> object:
        seen.extend(photos if name == "scene" else [])
        return original(name, photos, *args, **options)

    run._train = spy  # type: ignore[method-assign]
    run.scene_stage()
    assert set(seen) & set(selected) == set(selected[1::2])
    assert set(seen) | set(selected) == {image.name for image in run.train_scene.images}


def test_another_request_is_refused_with_the_difference(scene: SfmScene, tmp_path: Path) -> None:
    Run(tmp_path, scene, [BOX], tiny("joint"))
    before = (tmp_path / "request.json").read_bytes()
    with pytest.raises(RunFolderError, match=r"config\.seed was 0, now 1"):
        Run(tmp_path, scene, [BOX], tiny("joint", seed=1))
    assert (tmp_path / "request.json").read_bytes() == before


@pytest.mark.parametrize("init", ["points", "box"])
def test_ablations_of_the_start(scene: SfmScene, tmp_path: Path, init: str) -> None:
    config = tiny("independent", roi_init=init)
    run = Run(tmp_path, scene, [BOX], replace(config, roi=replace(config.roi, steps=1)))
    base = run.scene_stage()
    stage = run.object_stage(BOX)
    wanted = len(scene.points) if init == "points" else int(base.gaussians.in_box(BOX).sum())
    assert len(stage.gaussians) == wanted
