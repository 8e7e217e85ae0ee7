"""Another Python process that is in the middle of something."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


@contextmanager
def in_the_middle(code: str, path: Path, says: str) -> Iterator[subprocess.Popen[str]]:
    """A process that runs `code` with `path` and has printed `says`; its input closes at the end.

    Args:
        code: Python; `sys.argv[1]` is the path. It waits for the end of standard input.
        path: for the code.
        says: the line that it prints once it is in the middle.
    """
    command, pipe = [sys.executable, "-c", code, str(path)], subprocess.PIPE
    with subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == f"{says}\n"
        yield process
