"""The command line for the tests: called, or as a separate process."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import roigs_engine
from roigs_engine.cli import main
from tests import warm_engine

ROOT = Path(roigs_engine.__file__).resolve().parent.parent
BOX = "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5"
EMPTY = "nothing=30,30,30,31,31,31"  # no points in it


def start(*arguments: object, cold: bool = False) -> subprocess.Popen[str]:
    """The command line as a separate process, its input open.

    Args:
        arguments: of the command line.
        cold: a new Python, as users start it; else it is forked (`tests.warm_engine`).
    """
    new = [sys.executable, "-m", "roigs_engine", *map(str, arguments)]
    command = new if cold else warm_engine.command(arguments)
    pipe = subprocess.PIPE
    return subprocess.Popen(
        command,
        cwd=ROOT,
        stdin=pipe,
        stdout=pipe,
        stderr=pipe,
        encoding="utf-8",
        errors="replace",
    )


def python(*arguments: object, cold: bool = False) -> subprocess.CompletedProcess[str]:
    """The command line as a separate process, to its end; its input stays open until then."""
    with start(*arguments, cold=cold) as process:
        assert process.stdout is not None and process.stderr is not None
        out, err = process.stdout.read(), process.stderr.read()
        return subprocess.CompletedProcess(process.args, process.wait(120), out, err)


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run a command that must fail as people expect; returns its one line."""
    assert main([str(argument) for argument in arguments]) == 2
    out, err = capsys.readouterr()
    lines = err.strip().splitlines()
    assert out == ""
    assert len(lines) == 1, err
    assert lines[0].startswith("error: ")
    assert "Traceback" not in err
    return lines[0]
