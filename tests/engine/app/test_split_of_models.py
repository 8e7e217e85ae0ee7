"""The split that models are tested on, found by where they lie."""

from __future__ import annotations

from pathlib import Path

from roigs_engine.app.evaluate import _split_of_run
from roigs_engine.context import QUIET
from roigs_engine.formats import run_files
from roigs_engine.formats.stage_list import write_stage_list


def test_it_is_that_of_the_settings_that_the_models_were_trained_with(tmp_path: Path) -> None:
    stages, earlier = tmp_path / run_files.STAGES, tmp_path / run_files.EARLIER / "0123abcd"
    now, before = stages / "joint-0000000a", stages / "joint-0000000b"
    write_stage_list(tmp_path, {"joint": now})
    earlier.mkdir(parents=True)
    for folder in (tmp_path, earlier):
        (folder / run_files.SPLIT).write_text("{}", encoding="utf-8")
    own, former = tmp_path / run_files.SPLIT, earlier / run_files.SPLIT
    result = run_files.RESULT
    assert _split_of_run([tmp_path / result, now / run_files.MODEL], QUIET) == own
    assert _split_of_run([tmp_path / run_files.FINE / "vase.ply"], QUIET) == own
    assert _split_of_run([earlier / result], QUIET) == former
    assert _split_of_run([earlier / result, tmp_path / result], QUIET) is None
    assert _split_of_run([before / run_files.MODEL], QUIET) is None
    assert _split_of_run([tmp_path.parent / result], QUIET) is None
