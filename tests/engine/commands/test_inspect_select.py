"""`inspect` and `select`: what they print and write, and what they need."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from roigs_engine.cli import main
from roigs_engine.selection import METHODS
from tests.engine.commands.command_line import BOX, ROOT, python
from tests.engine.synthetic_colmap import Project


def test_select_end_to_end(
    project: Project, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--roi", BOX, "--method", "greedy", "--count", "3", "--out", str(tmp_path)]
    assert main(["select", str(project.folder), *arguments]) == 0
    shown = capsys.readouterr().out
    assert shown.endswith(f"\n1 list of photos in {tmp_path}\n")
    stored = json.loads((tmp_path / "thing.json").read_text(encoding="utf-8"))
    assert (stored["roi"], stored["method"], len(stored["names"])) == ("thing", "greedy", 3)
    assert set(stored["names"]) <= set(project.names)
    assert all(name in shown for name in stored["names"])


def test_photos_are_excluded(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    def inspect(*arguments: str) -> str:
        status = main(["inspect", str(project.folder), "--json", *arguments])
        said = capsys.readouterr()
        return said.out if status == 0 else said.err

    count = len(project.names)
    first, second = project.names[:2]
    record = json.loads(inspect("--exclude", first, "--exclude", second))
    assert record["photos"] == count - 2
    assert record["skipped"]["excluded"] == {"count": 2, "first": sorted([first, second])}
    assert "no photo 'none.png'" in inspect("--exclude", "none.png")
    every = [word for name in project.names for word in ("--exclude", name)]
    assert "leaves no photo" in inspect(*every)


WITHOUT = """
import sys
from importlib.abc import MetaPathFinder

class Missing(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in missing:
            raise ModuleNotFoundError("it is not here", name=name)

missing, folder, box, out, *methods = sys.argv[1:]
missing = set(missing.split(","))
sys.meta_path.insert(0, Missing())
from roigs_engine.cli import main
for method in methods:
    assert main(["select", folder, "--roi", box, "--method", method, "--test-every", "4"]) == 0
assert main(["inspect", folder, "--roi", box]) == 0
assert main(["export", folder, "--out", out]) == 0
assert not missing & {name.partition(".")[0] for name in sys.modules}
assert main(["train", folder, "--roi", box, "--run-dir", out]) == 2
"""


ALL_BUT_NUMPY = "torch,sklearn,scipy,PIL,pycolmap,tqdm"


def without(missing: str, project: Project, out: Path, *methods: str) -> str:
    """Standard output of selecting, inspecting and exporting in a Python without these."""
    command = [sys.executable, "-c", WITHOUT, missing, str(project.folder), BOX, str(out), *methods]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert "error: `train` needs torch" in result.stderr
    return result.stdout


def test_inspect_and_every_selection_need_no_torch(project: Project, tmp_path: Path) -> None:
    shown = without("torch", project, tmp_path / "out", *METHODS)
    assert all(f"selected by {method}" in shown for method in METHODS)


def test_what_blender_runs_itself_needs_numpy_alone(project: Project, tmp_path: Path) -> None:
    methods = [method for method in METHODS if not method.startswith("gp")]
    lean = without(ALL_BUT_NUMPY, project, tmp_path / "a", *methods)
    assert without("torch", project, tmp_path / "b", *methods).replace("/b", "/a") == lean
    for name in ("scene.json", "points.npy", "observed.npy"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_test_photos_are_not_selected(project: Project, tmp_path: Path) -> None:
    arguments = ["--roi", BOX, "--test-every", "4", "--count", "8", "--out", str(tmp_path)]
    assert main(["select", str(project.folder), *arguments]) == 0
    stored = json.loads((tmp_path / "thing.json").read_text(encoding="utf-8"))
    assert len(stored["candidates"]) == 6
    assert "(2 of the 8 that see it are test photos)" in stored["flags"][0]


def test_inspect_in_json(project: Project, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(project.folder), "--roi", BOX, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["photos"] == len(project.names)
    assert report["points"] == len(project.points)
    assert report["rois"][0]["name"] == "thing"


@pytest.mark.skipif(sys.platform != "linux", reason="names are text there")
@pytest.mark.parametrize(
    ("encoding", "options"),
    [("utf-8", []), ("ascii", []), ("ascii", ["--json"]), ("ascii", ["--events"])],
)
def test_names_that_cannot_be_printed(
    project: Project,
    tmp_path: Path,
    encoding: str,
    options: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A photo on disk whose name is no UTF-8, and an output that has few letters."""
    shutil.copytree(project.folder, tmp_path / "scene")
    photos = os.fsencode(tmp_path / "scene" / "images")
    shutil.copy(os.path.join(photos, b"0.png"), os.path.join(photos, b"caf\xe9.png"))
    monkeypatch.setenv("PYTHONIOENCODING", encoding)
    result = python("inspect", tmp_path / "scene", *options, cold=True)
    assert result.returncode == 0 and "Traceback" not in result.stderr
    assert "caf\\udce9.png" in result.stdout + result.stderr
