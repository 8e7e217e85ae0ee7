"""Names with control characters: a terminal and a table show escapes, programs get the names."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.cli import main
from roigs_engine.formats.text import CONTROLS
from roigs_engine.model.gaussians import Gaussians
from tests.engine.commands.command_line import BOX, python, refused
from tests.engine.synthetic_colmap import Project, write_project

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="files cannot be called so there")
ODD = ["a\x1b[2Jb.png", "c\nwarning: d.png", "e\rf.png", "g\x7f.png", "h\x9b1m.png", "i\u202e.png"]
SHOWN = [*(r"a\x1b[2Jb.png", r"c\nwarning: d.png", r"e\rf.png", r"g\x7f.png", r"h\x9b1m.png"),
         r"i\u202e.png"]  # fmt: skip


@pytest.fixture(scope="module")
def odd(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """A scene whose photos have odd names; two of them are damaged."""
    made = write_project(tmp_path_factory.mktemp("odd") / "scene", names=[*ODD, "j.png", "k\t.png"])
    for name in ("j.png", "k\t.png"):
        (made.folder / "images" / name).write_bytes(b"")
    return made


def clean(text: str) -> bool:
    """Whether a terminal shows the text as it is."""
    return not CONTROLS.search(text.replace("\n", ""))


def test_answers_and_messages_are_clean(
    odd: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["inspect", str(odd.folder)]) == 0
    out, err = capsys.readouterr()
    assert clean(out) and clean(err)
    assert r"skipped  2 unreadable: j.png, k\t.png" in out and r"k\t.png" in err
    select = ["select", str(odd.folder), "--roi", BOX, "--count", str(len(ODD))]
    assert main([*select, "--out", str(tmp_path)]) == 0
    out, err = capsys.readouterr()
    assert clean(out) and clean(err)
    head, *rows = out.split("\n")[1 : 2 + len(ODD)]
    names = slice(head.index("photo"), head.index("score") - 1)
    assert {row[names].split("  ")[0].rstrip() for row in rows} == set(SHOWN)
    assert {len(row) for row in rows} == {len(head)}
    stored = json.loads((tmp_path / "thing.json").read_text(encoding="utf-8"))
    assert set(stored["names"]) == set(ODD)


def test_errors_are_clean_and_one_line(
    odd: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ply = tmp_path / "a.ply"
    Gaussians.from_points(np.zeros((1, 3)), np.zeros((1, 3), np.uint8)).save_ply(ply)
    render = ["render", ply, "--scene", odd.folder, "--out", tmp_path / "out", "--device", "cpu"]
    assert main([*map(str, render), "--name", "x\x1b[2J"]) == 2
    err = capsys.readouterr().err
    assert clean(err) and r"no camera 'x\x1b[2J'" in err.splitlines()[-1]
    assert r"'\x1b]0;x\x07'" in refused(capsys, "inspect", odd.folder, "--only", "\x1b]0;x\x07")
    box = tmp_path / "rois.json"
    box.write_text(json.dumps([{"name": "a\x9b\x85b", "min": [0] * 3, "max": [1] * 3}]))
    assert r"a\x9b" in refused(capsys, "inspect", odd.folder, "--rois", box)


def test_a_report_is_a_table_whatever_the_names(
    odd: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ply, out = tmp_path / "a.ply", tmp_path / "out"
    Gaussians.from_points(odd.points, np.zeros((len(odd.points), 3), np.uint8)).save_ply(ply)
    models = [f"--model=A\x1b[2J|B\n| x |={ply}", f"--model=C\x9b\u2028={ply}"]
    split = tmp_path / "split.json"
    split.write_text(json.dumps({"test": ODD[:2]}), encoding="utf-8")
    scene = ["evaluate", str(odd.folder), "--roi", BOX, "--device", "cpu", "--split", str(split)]
    assert main([*scene, *models, "--out", str(out)]) == 0
    shown, said = capsys.readouterr()
    report = (out / "report.md").read_bytes().decode("utf-8")
    assert clean(report) and clean(shown)
    assert clean(said.replace("\r", ""))  # progress bars go back to the start of a line
    table = [line for line in report.split("\n") if line.startswith("| ")]
    assert len(table) == 8  # two tables
    for lines in (table[:4], table[4:]):
        assert len({len(line) for line in lines}) == 1
        assert r"A\\x1b\[2J\|B \| x \|" in lines[2]
    page = f"page:     {out / 'report.html'}"
    assert shown.endswith(f"\nreport:   {out / 'report.md'}\n{page}\npictures: {out / 'crops'}\n")
    record = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert record["test_views"] == ODD[:2]


def test_programs_get_the_true_names(odd: Project) -> None:
    result = python("select", odd.folder, "--roi", BOX, "--test-every", 4, "--events")
    assert result.returncode == 0 and clean(result.stderr)
    assert clean(result.stdout)  # what JSON may hold as it is would end a line for some readers
    texts = [json.loads(line).get("text", "") for line in result.stdout.split("\n") if line]
    assert any("k\t.png" in text for text in texts)
