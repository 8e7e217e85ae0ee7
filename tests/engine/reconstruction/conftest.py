"""Fixtures of the tests of reconstruction."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from roigs_engine.reconstruction import child
from tests import warm_engine


@pytest.fixture(scope="module", autouse=True)
def warm_worker() -> Iterator[None]:
    """Workers are forked from a process that has imported pycolmap."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(child, "WORKER", warm_engine.module(child.WORKER[-1]))
        yield
