"""Finished stages whose files were damaged: made again with a warning, never silently used."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import pytest

from roigs_engine.context import Context
from roigs_engine.errors import RunFolderError, Stopped
from roigs_engine.formats.events import Event, Message
from roigs_engine.formats.text import json_digest
from roigs_engine.model.scene import SfmScene
from roigs_engine.run import stage_folder
from roigs_engine.run.definition import define_run
from roigs_engine.run.dry_run import describe_plan
from roigs_engine.run.executor import Executor
from roigs_engine.run.manifest import claim
from roigs_engine.run.stage_folder import DamagedError, StageFolder, read_record
from roigs_engine.run.strategies import plan_run
from tests.engine.killing import Request, contents, engine
from tests.engine.runs import plys, stage_of, tiny, train
from tests.engine.synthetic_scene import BOX, make_scene

Damage = Callable[[Path], None]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


@pytest.fixture(scope="module")
def undamaged(scene: SfmScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run, to copy."""
    run = tmp_path_factory.mktemp("undamaged")
    train(run, scene, [BOX], tiny("joint"))
    return run


def flipped(path: Path, at: int = -5) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(data)


def changed(path: Path, **values: object) -> None:
    """A record with other values; those that are None are missing."""
    record = json.loads(path.read_text(encoding="utf-8")) | values
    path.write_text(
        json.dumps({k: v for k, v in record.items() if v is not None}), encoding="utf-8"
    )


DAMAGES: dict[str, Damage] = {
    "a bit of the model": lambda folder: flipped(folder / "model.ply"),
    "a short model": lambda folder: (folder / "model.ply").write_bytes(b"ply\n"),
    "no model": lambda folder: (folder / "model.ply").unlink(),
    "no seconds": lambda folder: changed(folder / "stage.json", seconds=None),
    "words for seconds": lambda folder: changed(folder / "stage.json", seconds="ten"),
    "another fingerprint": lambda folder: changed(folder / "stage.json", fingerprint="../../x"),
    "no checksum": lambda folder: changed(folder / "stage.json", checksum=None),
    "an empty record": lambda folder: (folder / "stage.json").write_bytes(b""),
    "a list": lambda folder: (folder / "stage.json").write_text("[]"),
    "no text": lambda folder: (folder / "stage.json").write_bytes(b"\xff\xfe\0"),
    "a deep record": lambda folder: (folder / "stage.json").write_text("[" * 200_000),
}


def warned(folder: Path, scene: SfmScene, *, update: bool = False) -> list[str]:
    """The warnings of a run on the folder."""
    events: list[Event] = []
    context = Context(emit=events.append)
    train(folder, scene, [BOX], tiny("joint"), update=update, context=context)
    return [e.text for e in events if isinstance(e, Message) and e.level == "warning"]


@pytest.mark.parametrize(("damage", "update"), [("a bit of the model", True), ("a list", False)])
def test_a_damaged_stage_is_made_again(
    scene: SfmScene, undamaged: Path, tmp_path: Path, damage: str, update: bool
) -> None:
    run = tmp_path / "run"
    shutil.copytree(undamaged, run)
    quiet = warned(run, scene)
    joint = stage_of(run, "joint")
    DAMAGES[damage](joint)
    texts = [text for text in warned(run, scene, update=update) if text not in quiet]
    assert len(texts) == 1, texts
    assert str(joint) in texts[0] and "repeated" in texts[0]
    assert plys(run) == plys(undamaged)
    assert list(joint.with_name(f"{joint.name}-damaged").iterdir())
    assert warned(run, scene, update=update) == quiet


@pytest.mark.parametrize("damage", DAMAGES)
def test_every_damage_is_found(
    scene: SfmScene, undamaged: Path, tmp_path: Path, damage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run ends where the stage would be trained again."""
    run, trained = tmp_path / "run", list[str]()
    shutil.copytree(undamaged, run)
    joint = stage_of(run, "joint")
    DAMAGES[damage](joint)

    def stop(folder: StageFolder, *_: object, **__: object) -> None:
        trained.append(folder.folder.name)
        raise Stopped

    monkeypatch.setattr(StageFolder, "train", stop)
    with pytest.raises(Stopped):
        warned(run, scene)
    assert trained == [joint.name]
    assert list(joint.with_name(f"{joint.name}-damaged").iterdir())


def test_a_plan_of_damaged_stages_changes_nothing(
    scene: SfmScene, undamaged: Path, tmp_path: Path
) -> None:
    shutil.copytree(undamaged, tmp_path / "run")
    run = define_run(tmp_path / "run", scene, [BOX], tiny("joint"))
    assert describe_plan(run).count("  done") == 2
    flipped(stage_of(run.folder, "joint") / "model.ply")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert describe_plan(run).count("  done") == 1
    assert before == {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}


def test_a_stage_is_verified_once(
    scene: SfmScene, undamaged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(undamaged, tmp_path / "run")
    verified: list[Path] = []
    monkeypatch.setattr(stage_folder, "check_model", lambda path, _: verified.append(path))
    run = define_run(tmp_path / "run", scene, [BOX], tiny("joint"))
    executor = Executor(run)
    for _ in range(2):
        executor.execute(plan_run(run))
    assert sorted(path.parent.name[:5] for path in verified) == ["joint", "scene"]


def test_a_stage_killed_at_its_end_resumes_from_its_checkpoint(
    request_: Request, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    engine(request_.arguments(run), request_.moment("^scene: after stage.json"))
    flipped(stage_of(run, "scene") / "model.ply")
    ended = engine(request_.arguments(run))
    assert ended.status == 0
    assert "resumed from its checkpoint" in ended.errors
    assert "scene: resumes at step" in ended.errors
    whole, made = contents(request_.whole), contents(run)
    assert {k: v for k, v in made.items() if "-damaged" not in k} == whole


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("gaussians", value) for value in ("x", [1], None, 1e999, -1, 1.5, True)),
        *(("seconds", value) for value in ("x", -1, [], 10**400)),
        *(("steps", "x"), ("cpu_seconds", {}), ("device", 5), ("model_sha256", 5)),
    ],
)
def test_a_record_of_other_values_with_the_right_checksum(
    tmp_path: Path, key: str, value: object
) -> None:
    """Whoever gives a run folder away can make one."""
    good = {
        "fingerprint": "a",
        "seconds": 1.0,
        "cpu_seconds": 1.0,
        "steps": 1,
        "gaussians": 1,
        "device": "cpu",
        "model_sha256": "b",
    }
    path = tmp_path / "stage.json"
    for values, said in ((good, ""), (good | {key: value}, "no record of a stage")):
        record = values | {stage_folder.CHECKSUM: json_digest(values)}
        path.write_text(json.dumps(record), encoding="utf-8")
        with pytest.raises(DamagedError, match=said) if said else nullcontext():
            read_record(path)


def test_a_record_of_no_finite_times(tmp_path: Path) -> None:
    (tmp_path / "stage.json").write_text('{"seconds": NaN}', encoding="utf-8")
    with pytest.raises(DamagedError):
        read_record(tmp_path / "stage.json")


@pytest.mark.parametrize("content", [b"", b"[1]", b"{", b"\xff"])
def test_a_damaged_manifest_is_one_line_with_a_way_out(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "manifest.json").write_bytes(content)
    with pytest.raises(RunFolderError) as caught:
        claim(tmp_path, {"a": 1}, update=False)
    assert caught.value.hint and "\n" not in str(caught.value)
    assert (tmp_path / "manifest.json").read_bytes() == content
