"""A processor in place of the card."""

from __future__ import annotations

import pytest

from roigs_engine.cuda import card
from tests.engine.cuda.shim import ShimProgram, compiled


@pytest.fixture
def shim(monkeypatch: pytest.MonkeyPatch) -> ShimProgram:
    """The kernels run on the processor, on tensors in main memory."""
    program = ShimProgram(compiled())
    monkeypatch.setattr(card, "program", lambda device: program)
    return program
