"""Fixtures that several of the engine's tests use."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from roigs_engine.errors import KernelError
from roigs_engine.kernels import bindings, library
from roigs_engine.rasterize import cpu


@pytest.fixture(scope="module", params=["generic", "avx2", "avx512", "neon"])
def isa(request: pytest.FixtureRequest) -> Iterator[str]:
    """Runs a test on every instruction set that was built and that this processor has."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(library.ISA_VARIABLE, request.param)
        try:
            kernels = library.load.__wrapped__()
        except KernelError as error:
            pytest.skip(str(error))
        patch.setattr(library, "load", lambda: kernels)
        loaded = bindings.bound(kernels)
        patch.setattr(bindings, "kernels", lambda: loaded)
        cpu.KernelView._idle.clear()  # they belong to another library
        yield request.param
        library.set_threads(None)
        cpu.KernelView._idle.clear()
