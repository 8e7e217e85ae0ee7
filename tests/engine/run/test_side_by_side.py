"""Several engines in one run folder."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from roigs_engine.context import QUIET
from roigs_engine.errors import RunFolderError
from roigs_engine.formats.lock import locked
from roigs_engine.model.scene import SfmScene
from roigs_engine.run import folder
from roigs_engine.run.folder import held, stage_held, train_stage
from roigs_engine.run.strategies import plan_run
from tests.engine.other_process import in_the_middle
from tests.engine.runs import opened, plys, tiny, train
from tests.engine.synthetic_scene import BOX, make_scene

HOLDING = """
import sys
from pathlib import Path
from roigs_engine.formats.lock import locked
folder, name = Path(sys.argv[1]).parent, Path(sys.argv[1]).name
with locked(folder, name=name):
    print("holding", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


def test_stages_one_by_one_make_the_bytes_of_a_run(tmp_path: Path, scene: SfmScene) -> None:
    config = tiny("independent")
    train(tmp_path / "whole", scene, [BOX], config)
    run = opened(tmp_path / "parts", scene, [BOX], config)
    plan = plan_run(run)
    for stage in plan.stages:
        train_stage(run, plan, stage.name, QUIET)
    apart = plys(tmp_path / "parts")
    assert {name: plys(tmp_path / "whole")[name] for name in apart} == apart
    assert not list((tmp_path / "parts").glob("*.lock"))
    with pytest.raises(RunFolderError, match=r"no stage 'attic'.* scene"):
        train_stage(run, plan, "attic", QUIET)


def test_a_folder_of_another_run_is_refused(tmp_path: Path, scene: SfmScene) -> None:
    opened(tmp_path, scene, [BOX], tiny("joint"))
    run = opened(tmp_path / "other", scene, [BOX], tiny("joint", seed=1))
    (tmp_path / "other" / "manifest.json").write_bytes((tmp_path / "manifest.json").read_bytes())
    with pytest.raises(RunFolderError, match="prepared for another run"):
        train_stage(run, plan_run(run), "scene", QUIET)


def test_an_engine_at_work_is_seen_from_both_sides(
    tmp_path: Path,
    scene: SfmScene,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(folder, "PATIENCE", 0.0)
    run = opened(tmp_path, scene, [BOX], tiny("joint"))
    stage = plan_run(run).stages[0]
    with in_the_middle(HOLDING, tmp_path / "scene.lock", "holding"):
        for attempt in (held(tmp_path, QUIET), stage_held(tmp_path, (stage,), QUIET)):
            with pytest.raises(RunFolderError, match="at work"), attempt:
                pass
    with (
        in_the_middle(HOLDING, tmp_path / "run.lock", "holding"),
        pytest.raises(RunFolderError, match="at work"),
        stage_held(tmp_path, (stage,), QUIET),
    ):
        pass


def test_locks_of_killed_engines_are_removed(tmp_path: Path) -> None:
    record = {"pid": 0, "started": 0, "events_from": 0}
    (tmp_path / "scene.lock").write_text(json.dumps(record), encoding="utf-8")
    with held(tmp_path, QUIET):
        assert [path.name for path in tmp_path.iterdir()] == ["run.lock"]
    with locked(tmp_path, name="batch.lock"):
        assert not (tmp_path / "run.lock").exists()
