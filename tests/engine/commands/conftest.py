"""A small scene, and signal handlers that come back."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from roigs_engine.commands.stopping import SIGNALS
from tests.engine.synthetic_colmap import Project, write_project


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Project:
    names = [f"{k}.png" for k in range(8)]
    return write_project(tmp_path_factory.mktemp("cli") / "a scene", names=names)


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """Commands take Ctrl-C and other signals over; give them back."""
    before = [signal.getsignal(number) for number in SIGNALS]
    yield
    for number, handler in zip(SIGNALS, before, strict=True):
        signal.signal(number, handler)
