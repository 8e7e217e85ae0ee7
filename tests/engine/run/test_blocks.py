"""A scene cut into blocks: cells, stages, one model of all, and when it is not cut."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.context import QUIET, Context
from roigs_engine.errors import ConfigError, RunFolderError, Stopped
from roigs_engine.evaluation.evaluate import evaluate
from roigs_engine.formats import run_files
from roigs_engine.formats.events import Event, Message
from roigs_engine.formats.splat_ply import read_ply
from roigs_engine.model.scene import SfmScene
from roigs_engine.run import definition as blocks_module
from roigs_engine.run.config import AUTO_BLOCKS, RunConfig
from roigs_engine.run.definition import Run, define_run
from roigs_engine.run.dry_run import describe_plan
from roigs_engine.run.folder import train_stage
from roigs_engine.run.memory import cell_memory, stage_memory
from roigs_engine.run.strategies import plan_run
from tests.engine.run.masked import masked
from tests.engine.runs import opened, plys, stage_of, tiny, train, train_run
from tests.engine.two_rooms import APART, BOXES, two_rooms


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return two_rooms(tmp_path_factory.mktemp("photos"))


@pytest.fixture(scope="module")
def whole(scene: SfmScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in two blocks."""
    folder = tmp_path_factory.mktemp("whole")
    train(folder, scene, BOXES, tiny("joint", blocks=2))
    return folder


@pytest.fixture(scope="module", autouse=True)
def few_photos_do() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blocks_module, "FEWEST", 4)
        yield


def messages(events: Sequence[Event]) -> str:
    return "\n".join(event.text for event in events if isinstance(event, Message))


def told(folder: Path, scene: SfmScene, config: RunConfig) -> tuple[Run, str]:
    """The run, and what is said about it."""
    events: list[Event] = []
    run = define_run(folder, scene, BOXES, config, context=Context(emit=events.append))
    return run, messages(events)


@pytest.mark.parametrize("strategy", ["joint", "independent"])
def test_blocks_are_trained_apart_and_joined(
    tmp_path: Path, scene: SfmScene, whole: Path, strategy: str
) -> None:
    config = tiny(strategy, blocks=2)
    if strategy == "joint":
        shutil.copytree(whole, tmp_path, dirs_exist_ok=True)
    run = define_run(tmp_path, scene, BOXES, config)
    plan = plan_run(run)
    cells = run.layout.blocks.cells
    assert sorted(roi.name for cell in cells for roi in cell.rois) == ["east", "west"]
    assert all(len(cell.rois) == 1 for cell in cells)
    names = [stage.name for stage in plan.stages]
    assert {"block-1-scene", "block-2-scene"} <= set(names) and "scene" not in names
    models = train_run(run)
    evaluation = evaluate(models, run.scene, run.test, run.rois)
    assert [table.roi for table in evaluation.rois] == ["east", "west"]
    # Each half of the result is the model of that half's block: nothing is there twice.
    last = "joint" if strategy == "joint" else "scene"
    result = read_ply(tmp_path / run_files.RESULT)["means"]
    for number, cell in enumerate(cells, start=1):
        own = read_ply(stage_of(tmp_path, f"block-{number}-{last}") / run_files.MODEL)["means"]
        west = cell.rois[0].name == "west"
        half = [(means[:, 0] > APART / 2) == west for means in (result, own)]
        outside = ~(BOXES[0].contains(result) | BOXES[1].contains(result))
        own_outside = ~(BOXES[0].contains(own) | BOXES[1].contains(own))
        assert (half[0] & outside).sum() == (half[1] & own_outside).sum() > 50
    assert all(run_files.is_own(path.name) for path in tmp_path.iterdir())


def test_the_same_bytes_whoever_trains_a_block(
    tmp_path: Path, scene: SfmScene, whole: Path
) -> None:
    config = tiny("joint", blocks=2)
    run = opened(tmp_path / "parts", scene, BOXES, config)
    plan = plan_run(run)
    for name in ("block-2-scene", "block-1-scene", "block-2-joint", "block-1-joint"):
        train_stage(run, plan, name, QUIET)
    train_run(run)
    assert plys(tmp_path / "parts") == plys(whole)


def test_without_blocks_nothing_changes(tmp_path: Path, scene: SfmScene) -> None:
    usual = define_run(tmp_path, scene, BOXES[:1], tiny("joint"))
    one = define_run(tmp_path, scene, BOXES[:1], tiny("joint", blocks=1))
    assert usual.layout.blocks is None and usual.layout.cells is None
    assert usual.manifest() == one.manifest() and "groups" not in usual.manifest()
    assert [s.fingerprint for s in plan_run(one).stages] == [
        s.fingerprint for s in plan_run(usual).stages
    ]


def test_a_folder_of_other_blocks_is_refused(tmp_path: Path, scene: SfmScene) -> None:
    opened(tmp_path, scene, BOXES, tiny("joint", blocks=2))
    with pytest.raises(RunFolderError, match="blocks was 2, now 1"):
        opened(tmp_path, scene, BOXES, tiny("joint"))


def test_fewer_blocks_if_they_had_few_photos(
    tmp_path: Path, scene: SfmScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(blocks_module, "FEWEST", 8)
    run, said = told(tmp_path, scene, tiny("joint", blocks=9))
    assert 1 < run.config.blocks < 9
    assert min(len(cell.photos) for cell in run.layout.blocks.cells) >= 8
    assert f"divided into {run.config.blocks} blocks instead of 9: of 18 photos" in said
    monkeypatch.setattr(blocks_module, "FEWEST", 24)
    run, said = told(tmp_path, scene, tiny("joint", blocks=3))
    assert run.config.blocks == 1 and "The scene is not divided into blocks: of 18 photos" in said


def test_auto_cuts_by_memory(
    tmp_path: Path, scene: SfmScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tiny("joint", blocks=AUTO_BLOCKS)
    run, said = told(tmp_path, scene, config)
    assert run.config.blocks == 1 and "block" not in said  # it fits
    need = [define_run(tmp_path, scene, BOXES, replace(config, blocks=n)).memory() for n in (1, 2)]
    assert need[1].total < need[0].total
    monkeypatch.setattr(blocks_module, "machine_memory", lambda: need[0].total - 1)
    run, said = told(tmp_path, scene, config)
    assert run.config.blocks == 2 and "The scene is divided into 2 blocks" in said
    monkeypatch.setattr(blocks_module, "machine_memory", lambda: 0)
    run, said = told(tmp_path, scene, config)
    assert run.config.blocks == 1 and "do not fit either" in said


def test_photos_around_one_thing_are_not_cut(
    tmp_path: Path, scene: SfmScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    orbit = scene.select([image.name for image in scene.images if image.name[0] != "w"])
    half = len(orbit.points) // 2
    orbit = replace(orbit, points=orbit.points[:half], colors=orbit.colors[:half])
    events: list[Event] = []
    context = Context(emit=events.append)
    run = define_run(tmp_path, orbit, BOXES[:1], tiny("joint", blocks=2), context=context)
    assert run.config.blocks == 2 and "Blocks save little here: 100%" in messages(events)
    monkeypatch.setattr(blocks_module, "machine_memory", lambda: 0)
    config = tiny("joint", blocks=AUTO_BLOCKS)
    run = define_run(tmp_path, orbit, BOXES[:1], config, context=context)
    assert run.config.blocks == 1 and "the photos all show most of it" in messages(events)


def test_the_plan_lists_the_blocks(tmp_path: Path, scene: SfmScene) -> None:
    run = define_run(tmp_path, scene, BOXES, tiny("joint", blocks=2))
    text = describe_plan(run)
    lines = [line for line in text.splitlines() if line.startswith("Block ")]
    assert len(lines) == 2
    for line, cell in zip(lines, run.layout.blocks.cells, strict=True):
        assert f"{len(cell.photos)} photos, {len(cell.points)} points" in line
        assert cell.rois[0].name in line and "GB" in line
    assert "block-2-joint" in text and "Joining the blocks takes" in text


def test_each_stage_needs_its_own_memory(tmp_path: Path, scene: SfmScene) -> None:
    run = define_run(tmp_path, scene, BOXES, tiny("joint", blocks=2))
    plan, whole = plan_run(run, ("full-scene",)), run.memory()
    needed = {
        stage.name: stage_memory(stage, run.train_scene, run.config, whole) for stage in plan.stages
    }
    cells = cell_memory(run.train_scene, run.layout, run.config)
    for number, cell in enumerate(cells[:2], start=1):
        assert needed[f"block-{number}-scene"] <= cell.total < needed["full-scene"]
    starts = {name for name in needed if name.endswith("-joint")}
    assert starts and all(needed[name] >= whole.joining for name in starts)  # from all blocks
    uncut = define_run(tmp_path, scene, BOXES, tiny("joint"))
    assert uncut.memory().joining == uncut.memory().total


def test_impossible_numbers_are_refused() -> None:
    with pytest.raises(ConfigError, match="blocks is 65"):
        tiny("joint", blocks=65)
    with pytest.raises(ConfigError, match="trains each box alone"):
        tiny("independent", groups=(("a",),))


def test_no_border_cuts_a_box(tmp_path: Path, scene: SfmScene) -> None:
    run = define_run(tmp_path, scene, BOXES, tiny("joint", blocks=4))
    for split in (run.layout.blocks, run.layout.cells):
        rng = np.random.default_rng(0)
        for roi in run.rois:
            inside = roi.centre + rng.uniform(-1, 1, (200, 3)) * roi.half_extents * 0.99
            assert len(set(split.partition.owners(inside))) == 1


def test_masks_of_objects_and_the_other_strategy(tmp_path: Path, scene: SfmScene) -> None:
    """A block without a masked object has no stage that cuts objects out."""
    with_masks = masked(scene, tmp_path, "east")
    run = define_run(tmp_path / "run", with_masks, BOXES[:1], tiny("joint", blocks=2))
    plan = plan_run(run, ["independent", "full-scene"])
    names = [stage.name for stage in plan.stages]
    assert sum(name.endswith("-cutout") for name in names) == 1
    assert {"compare-independent/block-2-scene", "compare-independent/object-east"} <= set(names)
    models = train_run(run, ["independent"])
    assert models[-1].name == "Joint, cut out"
    count = len(read_ply(tmp_path / "run" / run_files.RESULT)["means"])
    files = [run_files.BACKGROUND, f"{run_files.FINE}/east.ply"]
    parts = [len(read_ply(tmp_path / "run" / name)["means"]) for name in files]
    assert sum(parts) == count and min(parts) > 0


def test_a_stopped_run_resumes_to_the_same_bytes(
    tmp_path: Path, scene: SfmScene, whole: Path
) -> None:
    config = tiny("joint", blocks=2)
    stopped = 0
    for patience in range(50, 5000, 90):  # calls until it stops, ever later
        left = iter(range(patience))
        context = Context(should_stop=lambda left=left: next(left, None) is None)
        try:
            train(tmp_path / "stopped", scene, BOXES, config, context=context)
            break
        except Stopped:
            stopped += 1
    assert stopped > 2
    assert plys(tmp_path / "stopped") == plys(whole)
