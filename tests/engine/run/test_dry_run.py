"""`--dry-run` shows every stage and finished work; it writes and trains nothing."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from roigs_engine.context import Context
from roigs_engine.errors import RunFolderError, Stopped
from roigs_engine.formats.events import Event, Message, Progress
from roigs_engine.formats.lock import locked
from roigs_engine.model.scene import SfmScene
from roigs_engine.run import forecast
from roigs_engine.run.definition import define_run
from roigs_engine.run.dry_run import describe_plan
from roigs_engine.run.folder import open_folder
from roigs_engine.run.forecast import MOST_MEASURED, Estimator, expected_counts, model_of_size
from roigs_engine.run.plan import Stage
from roigs_engine.run.presets import preset
from roigs_engine.run.strategies import plan_run
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.mechanisms.importance_pruning import ImportancePruning
from tests.engine.runs import stage_of, tiny, train_run
from tests.engine.synthetic_scene import BOX, make_scene

ALL = ("full-scene", "full-object", "independent")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


def rows(text: str) -> dict[str, list[str]]:
    """Stage -> the words of its row."""
    lines = text.splitlines()
    begin = next(i for i, line in enumerate(lines) if line.startswith("stage ")) + 1
    end = lines.index("", begin)
    return {line.split()[0]: line.split() for line in lines[begin:end]}


def test_every_stage_has_a_row_and_nothing_is_written(scene: SfmScene, tmp_path: Path) -> None:
    run = define_run(tmp_path / "run", scene, [BOX], tiny("joint"))
    text = describe_plan(run, ALL)
    found = rows(text)
    stages = plan_run(run, ALL).stages
    assert list(found) == [stage.name for stage in stages]
    for stage in stages:
        assert found[stage.name][1] == str(len(stage.images))
        assert found[stage.name][3] == str(stage.config.steps)
        assert "done" not in found[stage.name]
    assert "Memory: up to about" in text and "on this machine" in text
    assert f"{len(run.train_scene.images)} to train on, {len(run.test)} to test on" in text
    assert not (tmp_path / "run").exists()


def test_what_is_done_is_said(scene: SfmScene, tmp_path: Path) -> None:
    run = define_run(tmp_path, scene, [BOX], tiny("joint"))
    train_run(run)
    before = sorted(path.stat().st_mtime_ns for path in tmp_path.rglob("*"))
    found = rows(describe_plan(run, ("full-scene",)))
    assert {name for name, row in found.items() if row[-1] == "done"} == {"scene", "joint"}
    assert before == sorted(path.stat().st_mtime_ns for path in tmp_path.rglob("*"))
    other = replace(run, config=tiny("joint", seed=1))
    text = describe_plan(other)
    assert "seed was 0, now 1" in text and "--update" in text
    assert "would move to 'earlier'" in describe_plan(other, update=True)
    open_folder(other, update=True)
    former = rows(describe_plan(run, update=True))
    assert {name for name, row in former.items() if row[-1] == "done"} == {"scene", "joint"}


def test_an_unfinished_stage_is_said_with_its_steps(scene: SfmScene, tmp_path: Path) -> None:
    run = define_run(tmp_path, scene, [BOX], tiny("joint"))
    events: list[Event] = []

    def stop() -> bool:
        """In the middle of the second stage."""
        steps = [e.step for e in events if isinstance(e, Progress) and e.stage == "joint"]
        return max(steps, default=0) > 5

    with pytest.raises(Stopped):
        train_run(run, context=Context(emit=events.append, should_stop=stop))
    text = describe_plan(run)
    unfinished = {name: row for name, row in rows(text).items() if row[-2:] == ["steps", "done"]}
    assert len(unfinished) == 1
    assert "are already done" in text
    other = replace(run, config=tiny("joint", seed=1))
    assert "steps done" not in describe_plan(other)


def test_a_folder_in_use_is_said(scene: SfmScene, tmp_path: Path) -> None:
    run = define_run(tmp_path, scene, [BOX], tiny("joint"))
    assert "at work" not in describe_plan(run)
    with locked(tmp_path):
        assert f"process {os.getpid()} is at work" in describe_plan(run)


def test_photos_that_nobody_has_looked_at_are_said(scene: SfmScene, tmp_path: Path) -> None:
    unknown = replace(scene, images=tuple(replace(i, digest="") for i in scene.images))
    distorted = replace(
        scene, images=tuple(replace(i, distorted=k < 3) for k, i in enumerate(scene.images))
    )
    for photos, text in ((unknown, "skips damaged ones"), (distorted, "removed from 3 first")):
        run = define_run(tmp_path, photos, [BOX], tiny("joint"))
        assert text in describe_plan(run)


def test_the_disk_space_is_said(
    scene: SfmScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = define_run(tmp_path / "missing/run", scene, [BOX], tiny("joint"))
    assert "Disk: up to about" in describe_plan(run)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1))
    monkeypatch.setattr(forecast, "WORTH_SAYING", 1)
    events: list[Event] = []

    def said() -> list[Message]:
        return [e for e in events if isinstance(e, Message) and e.text.startswith("Disk:")]

    with pytest.raises(Stopped):
        train_run(run, context=Context(emit=events.append, should_stop=lambda: bool(said())))
    (warning,) = said()
    assert warning.level == "warning" and "can be resumed" in warning.text


def test_progress_tells_the_time_to_the_end_of_the_run(
    scene: SfmScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(forecast, "WORTH_SAYING", 1)
    monkeypatch.setattr(Estimator, "_measured", lambda *_: 100.0)  # seconds a step
    events: list[Event] = []
    run = define_run(tmp_path, scene, [BOX], tiny("joint"))
    train_run(run, context=Context(emit=events.append))
    last = {e.stage: e for e in events if isinstance(e, Progress) and e.step == e.total}
    first, *later = plan_run(run).stages
    assert [*last] == [first.name, *(stage.name for stage in later)]
    assert last[first.name].run_seconds_left >= 100 * sum(s.config.steps for s in later)
    assert last[later[-1].name].run_seconds_left < 100 * later[-1].config.steps


def test_a_folder_of_another_version_is_refused(scene: SfmScene, tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text('{"version": 0}', encoding="utf-8")
    run = define_run(tmp_path, scene, [BOX], tiny("joint"))
    for work in (describe_plan, train_run):
        with pytest.raises(RunFolderError, match="another version") as caught:
            work(run)
        assert "--run-dir" in caught.value.hint
    assert [path.name for path in tmp_path.iterdir()] == ["manifest.json"]


def test_expected_counts_follow_the_schedule(scene: SfmScene, tmp_path: Path) -> None:
    run = define_run(tmp_path, scene, [BOX], tiny("joint"))
    for stage in plan_run(run, ALL).stages:
        counts = expected_counts(stage, 1000, share_in_boxes=0.2)
        assert len(counts) == stage.config.steps and counts[0] == 1000
        density = stage.config.get(DensityControl)
        ends = min(density.until if density else 0, len(counts))
        assert counts[: ends - 1] == sorted(counts[: ends - 1])
        assert len(set(counts[ends - 1 :])) == 1
        largest = max(counts)
        prunes = stage.config.get(ImportancePruning) is not None
        assert (counts[-1] < 0.8 * largest) if prunes else counts[-1] == largest


def test_a_stage_that_shrinks_is_timed_at_its_largest(scene: SfmScene, tmp_path: Path) -> None:
    run = define_run(tmp_path, scene, [BOX], preset("draft"))
    for stage in plan_run(run, ()).stages:
        estimator = Estimator(scene)
        asked = []

        def measured(stage: Stage, count: int, asked: list[int] = asked) -> float:
            asked.append(count)
            return 1e-3 * count

        estimator._measured = measured  # type: ignore[method-assign]
        found = estimator.estimate(stage, 1000)
        counts = expected_counts(stage, 1000, estimator._share_in_boxes(stage))
        assert (found.end, found.most) == (counts[-1], max(counts))
        assert found.end < found.most == max(asked)
        assert found.seconds == pytest.approx(1e-3 * sum(counts))


@pytest.mark.parametrize("share", [0.3, 1.0, 2.7])
def test_a_model_of_any_size_to_measure_with(scene: SfmScene, share: float) -> None:
    count = round(share * len(scene.points))
    model = model_of_size(scene, count)
    assert len(model) == count
    assert all(bool(tensor.isfinite().all()) for tensor in model.tensors().values())


def test_a_large_model_is_extrapolated_not_made(
    scene: SfmScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes: list[int] = []

    def measured(self: Estimator, stage: Stage, count: int) -> float:
        sizes.append(count)
        return 1e-6 * count

    monkeypatch.setattr(Estimator, "_measured", measured)
    stage = plan_run(define_run(tmp_path, scene, [BOX], tiny("joint"))).stages[0]
    found = Estimator(scene).estimate(stage, 50_000_000)
    assert max(sizes) <= MOST_MEASURED
    assert found.step_seconds == pytest.approx(1e-6 * found.end)


def test_a_stage_without_its_model_is_not_done(scene: SfmScene, tmp_path: Path) -> None:
    run = define_run(tmp_path, scene, [BOX], tiny("joint"))
    train_run(run)
    (stage_of(tmp_path, "joint") / "model.ply").unlink()
    found = rows(describe_plan(run))
    assert found["scene"][-1] == "done" and found["joint"][-1] != "done"
