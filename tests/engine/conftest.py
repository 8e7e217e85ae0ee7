"""Fixtures that several of the engine's tests use."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from roigs_engine.errors import KernelError
from roigs_engine.kernels import bindings, library
from roigs_engine.rasterize import cpu
from roigs_engine.storage import urls
from tests.engine.shared_runs import made_once


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


@pytest.fixture
def memory_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """An empty file system in memory, as fsspec has it, and a home for this machine's copies.

    A batch may have its run folders there: its engines' parts are in this process.
    """
    fsspec = pytest.importorskip("fsspec")
    monkeypatch.setattr(urls, "LOST", ())
    monkeypatch.setenv("ROIGS_CACHE", str(tmp_path / "home"))
    found = fsspec.filesystem("memory")
    found.store.clear()
    yield found
    found.store.clear()


@pytest.fixture
def mounted(tmp_path: Path) -> Iterator[Callable[[str], Path]]:
    """Mounts a file system in memory with the given options, or changes those it has."""
    folder = tmp_path / "disk"
    folder.mkdir()

    def mount(options: str) -> Path:
        change = ["-o", f"remount,{options}"] if os.path.ismount(folder) else ["-o", options]
        command = ["mount", "-t", "tmpfs", *change, "tmpfs", str(folder)]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            pytest.skip("file systems cannot be mounted here")
        return folder

    if sys.platform != "linux":
        pytest.skip("tmpfs is Linux's")
    yield mount
    if os.path.ismount(folder):
        subprocess.run(["umount", str(folder)], check=True)


@pytest.fixture(scope="session")
def request_(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A run that nobody killed, its scene and arguments."""
    from tests.engine.killing import Request  # it decides what its processes are forked from

    return Request(made_once(tmp_path_factory, "unkilled", Request.make))
