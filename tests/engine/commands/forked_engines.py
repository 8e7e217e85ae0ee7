"""Engines of a batch that start at once: forked from a process that has imported all they need.

A new Python with torch takes seconds. Everything else is as it is: pipes, events, exit status.
`test_engine_process.py` and `test_ray.py` start engines as users do.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from roigs_engine.batch import engine_process
from tests import warm_engine


def _popen(command: Sequence[str], **options: Any) -> subprocess.Popen[bytes]:
    arguments = command[command.index("roigs_engine") + 1 :]
    return subprocess.Popen(warm_engine.command(arguments), **options)


FORKED = SimpleNamespace(Popen=_popen, PIPE=subprocess.PIPE)


@pytest.fixture(scope="module")
def forked_engines() -> Iterator[None]:
    """The batches of a module's tests, in this process or forked, fork their engines."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine_process, "subprocess", FORKED)
        patch.setenv(warm_engine.IMPORTED_FIRST, "tests.engine.commands.forked_parts")
        yield
