"""A processor in place of a GPU."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from roigs_engine.gpu.program import Program, close_gpu, open_gpu
from tests.engine.gpu.software import software_adapter


@pytest.fixture
def software() -> Iterator[Program]:
    """The GPU that draws in this process; the test is skipped if there is none."""
    yield open_gpu(software_adapter().name)
    close_gpu()
