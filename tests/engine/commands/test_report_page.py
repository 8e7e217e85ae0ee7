"""`run` and `evaluate` write their report as a web page too."""

from __future__ import annotations

from pathlib import Path

import pytest

from roigs_engine.cli import main
from tests.engine.commands.command_line import BOX
from tests.engine.commands.photo_scenes import arguments, scene


def test_a_run_writes_its_report_as_a_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    assert main(arguments(scene(tmp_path), run)) == 0
    text = (run / "report.html").read_text(encoding="utf-8")
    assert "<h2>thing</h2>" in text and 'src="data:image/jpeg;base64,' in text
    assert str(run / "report.html") in capsys.readouterr().out


def test_an_evaluation_writes_one_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, out = tmp_path / "run", tmp_path / "out"
    given = arguments(scene(tmp_path), run)
    assert main(given) == 0
    capsys.readouterr()
    models = [f"{name}={run / 'result.ply'}" for name in ("A", "B")]
    options = [word for model in models for word in ("--model", model)]
    boxes = ["--roi", BOX]
    assert main(["evaluate", given[1], *boxes, *options, "--out", str(out)]) == 0
    text = (out / "report.html").read_text(encoding="utf-8")
    assert "<h2>thing</h2>" in text and 'src="data:image/jpeg;base64,' in text
    assert str(out / "report.html") in capsys.readouterr().out
