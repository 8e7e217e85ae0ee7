"""`benchmarks.blocks` on two tiny runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.blocks import Finished, rows
from roigs_engine.cli import main
from roigs_engine.run import definition
from tests.engine.commands.command_line import BOX
from tests.engine.synthetic_colmap import write_project


def test_the_table_of_a_run_in_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(definition, "FEWEST", 2)
    names = [f"{k}.png" for k in range(12)]
    project = write_project(tmp_path / "scene", names=names, dots=True)
    for run, number in (("whole", "1"), ("cut", "2")):
        tiny = ["--roi", BOX, "--steps-factor", "0.003", "--test-every", "4", "--device", "cpu"]
        folder = ["--run-dir", str(tmp_path / run), "--blocks", number, "--compare"]
        assert main(["run", str(project.folder), *tiny, *folder]) == 0
    one, two = (Finished.of(tmp_path / run) for run in ("whole", "cut"))
    whole, cut = rows(one, [two])
    assert whole[:2] == ["whole", "1"] and cut[:2] == ["cut", "2"]
    assert int(cut[2].replace(",", "")) > int(whole[2].replace(",", ""))  # photos are in both
    across = int(cut[5])
    assert 0 <= across <= len(one.test)
    assert (cut[6] == "") == (across == 0)
    # The same run has no difference to itself.
    same = list(rows(two, [two]))[1]
    assert {same[7], same[8], same[10]} <= {"+0.00", ""}
