"""Environments that several Blenders share: used, and removed when nobody uses them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from roigs_addon.engine import environments, python
from roigs_addon.engine.command import Engine
from roigs_addon.engine.process import EngineProcess
from roigs_addon.errors import AddonError
from tests.addon.scenes import ROOT


def make(folder: Path, name: str, *, complete: bool = True) -> Path:
    """An environment that holds a kilobyte; returns its Python."""
    program = python.environment_python(folder / name)
    program.parent.mkdir(parents=True)
    program.write_bytes(bytes(1000))
    if complete:
        (folder / name / python.MARKER).write_text("{}")
    return program


def test_removing_takes_what_was_made_and_nothing_else(tmp_path: Path) -> None:
    make(tmp_path, "1", complete=False)
    make(tmp_path, "2")
    (tmp_path / "setup.log").touch()
    (tmp_path / environments.DOWNLOADS).mkdir()
    for kept in ("mine", "3.txt"):
        (tmp_path / kept).mkdir()
    assert environments.remove_all([tmp_path, tmp_path / "nowhere"]) == 2002
    assert sorted(path.name for path in tmp_path.iterdir()) == ["3.txt", "mine"]


def test_links_are_not_followed(tmp_path: Path) -> None:
    elsewhere, folder = tmp_path / "elsewhere", tmp_path / "engine"
    make(elsewhere, "1")
    folder.mkdir()
    try:
        (folder / "1").symlink_to(elsewhere / "1", target_is_directory=True)
    except OSError:
        pytest.skip("no links here")
    assert environments.remove_all([folder]) == 0
    assert (elsewhere / "1" / python.MARKER).is_file()


def test_one_that_another_process_uses_stays(tmp_path: Path) -> None:
    used = make(tmp_path, "1")
    make(tmp_path, "2")
    code = (
        "import pathlib, sys; from roigs_addon.engine import environments\n"
        f"with environments.using(pathlib.Path({str(used)!r})): print(flush=True); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT
    ) as other:
        assert other.stdout is not None and other.stdin is not None
        other.stdout.readline()
        with pytest.raises(AddonError, match=rf"^An engine is running \(process {other.pid}\)"):
            environments.remove_all([tmp_path])
        environments.remove_replaced([tmp_path])
        assert len(python.complete_environments([tmp_path])) == 2
        other.kill()
    environments.remove_replaced([tmp_path])
    assert [path.name for path in python.complete_environments([tmp_path])] == ["2"]


def test_nothing_is_removed_during_an_installation(tmp_path: Path) -> None:
    make(tmp_path, "1")
    with environments.alone(tmp_path), pytest.raises(AddonError, match="is setting up the engine"):
        environments.remove_all([tmp_path])
    assert python.complete_environments([tmp_path])


def test_an_engine_uses_its_environment_until_it_ends(tmp_path: Path) -> None:
    environment = tmp_path / "1"
    program = python.environment_python(environment)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(environment)], check=True)
    (environment / python.MARKER).write_text("{}")
    source = tmp_path / "source" / "roigs_engine"
    source.mkdir(parents=True)
    (source / "__main__.py").write_text("input()")
    process = EngineProcess(Engine(python=program, source=source.parent), ["train"])
    assert environments.user(environment) and not environments.remove(environment)
    process.stop()
    assert process.wait(20)
    assert not environments.user(environment)
    process.result()
    assert environments.remove(environment) and not environment.exists()


def test_an_environment_that_was_removed_just_now_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = make(tmp_path, "1")
    locked = environments.lock.locked

    def removed_meanwhile(folder: Path):
        (tmp_path / "1" / python.MARKER).unlink()
        return locked(folder)

    monkeypatch.setattr(environments.lock, "locked", removed_meanwhile)
    with pytest.raises(OSError, match="was removed"), environments.using(program):
        pass


def test_a_python_of_the_users_own_gets_no_files(tmp_path: Path) -> None:
    program = make(tmp_path, "own", complete=False)
    with environments.using(program):
        assert [path.name for path in (tmp_path / "own").iterdir()] == [program.parent.name]
