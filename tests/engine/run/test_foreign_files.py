"""A run in a folder with files of others replaces and removes none of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from roigs_engine.context import QUIET
from roigs_engine.errors import RunFolderError
from roigs_engine.formats.lock import LOCK
from roigs_engine.formats.splat_ply import write_ply
from roigs_engine.run.definition import MANIFEST_VERSION
from roigs_engine.run.folder import held
from roigs_engine.run.manifest import check_version
from tests.addon.colmap_project import write_project
from tests.engine.commands.command_line import refused
from tests.engine.formats.gaussian_arrays import arrays

MINE = '{"name": "of another program"}'


@pytest.mark.parametrize("name", ["poetry.lock", "uv.lock", "flake.lock", "joint.lock"])
def test_lock_files_of_other_programs_stay(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(MINE)
    with held(tmp_path, QUIET):
        pass
    assert (tmp_path / name).read_text() == MINE


def test_the_lock_of_a_killed_stage_goes(tmp_path: Path) -> None:
    (tmp_path / "joint.lock").write_text('{"pid": 1, "started": 2.0, "events_from": 0}')
    with held(tmp_path, QUIET):
        assert [path.name for path in tmp_path.iterdir()] == [LOCK]


@pytest.mark.parametrize("beside", [None, "split.json", "provenance.json"])
@pytest.mark.parametrize("name", ["preview.ply", "settings.json", "report.md", "rois"])
def test_a_run_refuses_a_folder_with_files_that_it_would_replace(
    tmp_path: Path, name: str, beside: str | None
) -> None:
    """A file that is only called as one of a run's does not make the folder one."""
    for each in filter(None, (name, beside)):
        (tmp_path / each).write_text(MINE)
    with pytest.raises(RunFolderError, match="is not a run folder, and a run would replace"):
        check_version(tmp_path)


@pytest.mark.parametrize(
    "marker", ['split.json {"evaluate_on": "test", "test": []}', 'provenance.json {"entries": []}']
)
def test_a_run_that_has_lost_its_manifest_is_one(tmp_path: Path, marker: str) -> None:
    name, _, text = marker.partition(" ")
    (tmp_path / name).write_text(text)
    (tmp_path / "result.ply").touch()
    check_version(tmp_path)


NAMES = ("events.jsonl", "cache/photos.json", "cache/exposures.json", "cluster.json")
EARLY = {
    "events.jsonl": '{"event": "message", "text": "x"}\n{"event": "half',
    "cache/photos.json": '{"version": 1, "photos": {}}',
    "cache/exposures.json": '{"key": "", "stops": {}}',
    "cluster.json": '{"scene": "garden"}',
}
"""What an engine may have left that was killed before it wrote its manifest."""


@pytest.mark.parametrize("text", [MINE, "mine", "[" * 9, '{"event": 5', "5"])
@pytest.mark.parametrize("name", NAMES)
def test_a_run_refuses_a_folder_with_logs_and_caches_of_others(
    tmp_path: Path, name: str, text: str
) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text(text)
    with pytest.raises(RunFolderError, match=f"a run would replace .*{name}"):
        check_version(tmp_path)
    (tmp_path / "manifest.json").write_text(f'{{"config": {{}}, "version": {MANIFEST_VERSION}}}')
    check_version(tmp_path)  # now it is a run's, and damaged


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("cut", [None, 0])
def test_what_a_killed_engine_has_left_is_its_own(
    tmp_path: Path, name: str, cut: int | None
) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text(EARLY[name][:cut])
    check_version(tmp_path)


def test_evaluate_keeps_the_caches_of_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, model = write_project(tmp_path / "scene"), tmp_path / "a.ply"
    write_ply(model, arrays(5))
    mine = tmp_path / "out" / "cache" / "photos.json"
    mine.parent.mkdir(parents=True)
    mine.write_text(MINE)
    box = ["--roi", "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5"]
    words = ["evaluate", scene, *box, "--model", f"A={model}", "--out", tmp_path / "out"]
    assert "photos.json would be replaced" in refused(capsys, *words, "--test-every", "2")
    assert mine.read_text() == MINE
