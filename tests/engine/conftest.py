"""Fixtures that several of the engine's tests use."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from roigs_engine.errors import KernelError
from roigs_engine.kernels import library
from roigs_engine.rasterize import cpu


@pytest.fixture(params=["generic", "avx2", "avx512", "neon"])
def isa(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Runs a test on every instruction set that was built and that this processor has."""
    monkeypatch.setenv(library.ISA_VARIABLE, request.param)
    monkeypatch.setattr(library, "load", library.load.__wrapped__)
    try:
        kernels = cpu._kernels.__wrapped__()
    except KernelError as error:
        pytest.skip(str(error))
    monkeypatch.setattr(cpu, "_kernels", lambda: kernels)
    cpu.View._idle.clear()
    yield request.param
    cpu.View._idle.clear()
