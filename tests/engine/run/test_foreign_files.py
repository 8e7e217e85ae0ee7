"""A run in a folder with files of others replaces and removes none of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from roigs_engine.context import QUIET
from roigs_engine.errors import RunFolderError
from roigs_engine.formats.lock import LOCK
from roigs_engine.run.folder import held
from roigs_engine.run.manifest import check_version

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
