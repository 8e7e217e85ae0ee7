"""A shell that limits memory: one line, exit status 2, no abort and no hang of a library."""

from __future__ import annotations

import errno
import subprocess
import sys
from pathlib import Path

import pytest

from roigs_engine import machine
from roigs_engine.commands import process
from roigs_engine.errors import EngineError
from roigs_engine.machine import is_memory_full
from tests.engine.commands.command_line import BOX, ROOT
from tests.engine.synthetic_colmap import Project

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="other systems ignore the limit")


def limited(megabytes: int, *arguments: object) -> subprocess.CompletedProcess[str]:
    """The command line in a shell with `ulimit -v`."""
    command = [sys.executable, "-m", "roigs_engine", *map(str, arguments)]
    return subprocess.run(
        ["sh", "-c", f'ulimit -v {megabytes * 1024}; exec "$@"', "sh", *command],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@LINUX
@pytest.mark.parametrize(
    ("megabytes", "command"),
    [
        *((megabytes, "inspect") for megabytes in (40, 80, 120, 280)),
        *((megabytes, "train") for megabytes in (60, 400, 500, 800, 1000)),
    ],
)
def test_too_little_memory_is_one_line(
    project: Project, tmp_path: Path, megabytes: int, command: str
) -> None:
    folder = ["--run-dir", tmp_path / "run"] if command == "train" else []
    result = limited(megabytes, command, project.folder, "--roi", BOX, *folder)
    assert result.returncode == 2 and result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ") and f"{megabytes} MB" in line and "ulimit -v" in line
    assert not (tmp_path / "run").exists()


@LINUX
def test_enough_memory(project: Project) -> None:
    result = limited(8000, "inspect", project.folder)
    assert result.returncode == 0 and result.stderr == ""


def test_cores_that_are_not_ours_need_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "address_space", lambda: 1500 << 20)
    monkeypatch.setattr(machine.os, "cpu_count", lambda: 128)
    monkeypatch.setattr(machine.os, "sched_getaffinity", lambda pid: {0, 1}, raising=False)
    process.check_address_space("training", 1200 << 20, 100 << 20)
    monkeypatch.setattr(machine.os, "sched_getaffinity", lambda pid: set(range(4)), raising=False)
    with pytest.raises(EngineError, match="needs 1600 MB"):
        process.check_address_space("training", 1200 << 20, 100 << 20)


def test_memory_that_is_full_has_many_names(monkeypatch: pytest.MonkeyPatch) -> None:
    wrapped = ImportError("numpy could not be imported")
    wrapped.__cause__ = ImportError("numpy.so: failed to map segment from shared object")
    assert not is_memory_full(wrapped)  # no limit is set: the disk is mounted noexec
    monkeypatch.setattr(machine, "address_space", lambda: 2 * machine.GIB)
    full = (
        MemoryError(),
        wrapped,
        OSError(errno.ENOMEM, "Cannot allocate memory", "file"),
        RuntimeError("can't start new thread"),
        RuntimeError("DefaultCPUAllocator: can't allocate memory: you tried"),
    )
    assert all(map(is_memory_full, full))
    others = (RuntimeError("shapes"), OSError(errno.ENOSPC, "No space left"), ImportError("x"))
    assert not any(map(is_memory_full, others))
