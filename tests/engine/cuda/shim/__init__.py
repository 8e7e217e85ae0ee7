"""The CUDA kernels on a processor: their own sources against cuda_shim.h, compiled with g++."""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from roigs_engine.cuda.compiler import headers, source_text

Edit = tuple[str, str, str]
FOLDER = Path(__file__).parent
FLAGS = (
    *("-std=c++17", "-fPIC", "-shared", "-Wall", "-Wno-unknown-pragmas"),
    "-U_FORTIFY_SOURCE",  # it forbids jumps from one stack to another
)


class ShimProgram:
    """Launches kernels of a compiled shim; `launched` are their names."""

    def __init__(self, library: Path) -> None:
        self._launch = ctypes.CDLL(str(library)).shim_launch
        self._launch.restype = ctypes.c_char_p
        self.launched: list[str] = []

    def launch(self, kernel: str, blocks: int, threads: int, argument: ctypes.Structure) -> None:
        """Runs the kernel; a RuntimeError says what it did wrong."""
        self.launched.append(kernel)
        wrong = self._launch(kernel.encode(), blocks, threads, ctypes.byref(argument))
        if wrong:
            raise RuntimeError(f"{kernel}: {wrong.decode()}")


def compiled(flags: Sequence[str] = ("-O2",), edits: Sequence[Edit] = ()) -> Path:
    """The shim's library, made once per source; skips without a compiler or these fibers.

    Args: `edits`: the name of a source, what to replace in it, and by what.
    """
    compiler = shutil.which("g++")
    if compiler is None or sys.platform != "linux":
        pytest.skip("the shim needs g++ and Linux's fibers")
    texts = {name: text for name, text in headers().items() if name != "cstdint"}
    texts["roigs.cu"] = source_text()
    for name, old, new in edits:
        assert texts[name].count(old) == 1, (name, old)
        texts[name] = texts[name].replace(old, new)
    texts |= {path.name: path.read_text() for path in FOLDER.glob("*shim.*")}
    key = hashlib.sha256(repr((sorted(texts.items()), flags)).encode()).hexdigest()[:16]
    library = Path(tempfile.gettempdir()) / f"roigs-shim-{os.getuid()}" / f"{key}.so"
    if library.is_file():
        return library
    library.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir=library.parent) as scratch:
        for name, text in texts.items():
            Path(scratch, name).write_text(text)
        made = Path(scratch, "shim.so")
        subprocess.run(
            [compiler, *FLAGS, *flags, "-o", str(made), str(Path(scratch, "shim.cpp"))], check=True
        )
        made.replace(library)
    return library
