"""Modules beside the photos are never imported: by the command line, nor by what it starts."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from roigs_engine.batch.engine_process import DONE, run_engine
from roigs_engine.context import QUIET
from roigs_engine.errors import EngineError
from roigs_engine.kernels import build
from roigs_engine.machine import child_environment
from roigs_engine.reconstruction.child import run_task
from tests.engine.synthetic_colmap import write_project

MODULES = ("numpy", "PIL", "torch", "pycolmap", "json", "argparse", "sitecustomize", "roigs_engine")
ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file that modules in the working folder leave when they are imported."""
    left = tmp_path / "left"
    for name in MODULES:
        (tmp_path / "photos").mkdir(exist_ok=True)
        text = f"open({str(left)!r}, 'a').write({name!r})\n"
        (tmp_path / "photos" / f"{name}.py").write_text(text)
    write_project(tmp_path / "scene", names=["1.png", "2.png"])
    monkeypatch.chdir(tmp_path / "photos")
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    return left


def test_the_command_line(left: Path, tmp_path: Path) -> None:
    # `roigs_engine` itself is where the user's Python finds it: here, it must not be the folder's.
    (tmp_path / "photos" / "roigs_engine.py").unlink()
    words = [sys.executable, "-m", "roigs_engine", "inspect", str(tmp_path / "scene")]
    done = subprocess.run(
        words, capture_output=True, env=os.environ | {"PYTHONPATH": str(ROOT)}, check=False
    )
    assert done.returncode == 0, done.stderr
    assert not left.exists()


@pytest.mark.skipif(os.name == "nt", reason="Windows keeps the working folder of a program")
@pytest.mark.parametrize(
    "words", [["convert", "a.ply", "b.ply"], ["inspect", "s"], ["levels", "r"]]
)
def test_a_deleted_working_folder_is_one_line(words: list[str], tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    done = subprocess.run(
        ["sh", "-c", 'rmdir "$0" && exec "$@"', gone, sys.executable, "-m", "roigs_engine", *words],
        cwd=gone,
        capture_output=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=False,
        text=True,
    )
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("error: ")


@pytest.mark.parametrize("words", [["inspect"], ["select", "--roi", "a=-1,-1,-1,1,1,1"]])
def test_warnings_of_libraries_end_no_command(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_project(tmp_path / "scene", names=["1.png", "2.png"])
    monkeypatch.setenv("PYTHONWARNINGS", "error")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    words = [sys.executable, "-m", "roigs_engine", *words, str(tmp_path / "scene")]
    done = subprocess.run(words, capture_output=True, check=False, text=True)
    assert done.returncode == 0, done.stderr


def test_the_build_of_the_kernels(left: Path, tmp_path: Path) -> None:
    (tmp_path / "photos" / "roigs_engine.py").unlink()
    words = [sys.executable, "-m", "roigs_engine.kernels.build", "--help"]
    found = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(words, capture_output=True, env=found, check=False)
    assert done.returncode == 0, done.stderr
    assert not left.exists()


def test_engines_of_a_batch(left: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(["", ".", str(ROOT)]))
    words = ["inspect", str(tmp_path / "scene")]
    assert run_engine(words, lambda event: None, lambda: False).state == DONE
    assert not left.exists()


def test_the_child_of_reconstruct(left: Path, tmp_path: Path) -> None:
    with pytest.raises(EngineError):
        run_task({"work": "nothing", "database": "x"}, tmp_path / "log", QUIET)
    assert not left.exists(), (tmp_path / "log").read_text()


def test_its_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(["", "modules", str(tmp_path)]))
    found = child_environment()
    assert found["PYTHONPATH"].split(os.pathsep) == [str(ROOT), str(tmp_path)]
    assert found["PYTHONSAFEPATH"] == "1"


@pytest.mark.skipif(os.name == "nt", reason="makes programs of POSIX")
@pytest.mark.parametrize("entry", ["", "."])
def test_a_compiler_in_the_working_folder_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, entry: str
) -> None:
    """Windows looks there first, as POSIX does for such an entry of PATH."""
    (tmp_path / "own").mkdir()
    for folder, name in (("", "c++"), ("own", "g++")):
        (tmp_path / folder / name).write_text("#!/bin/sh\n")
        (tmp_path / folder / name).chmod(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", f"{entry}{os.pathsep}{tmp_path / 'own'}")
    for given, expected in (("", []), ("./c++", []), ("g++ -O1", ["-O1"])):
        monkeypatch.setenv("CXX", given)
        command, _ = build._compiler_command("cxx", build.native_platform())
        assert command == [str(tmp_path / "own" / "g++"), *expected]
