"""NVRTC, NVIDIA's run-time compiler: a library in torch's CUDA wheels and a wheel of its own.

It needs no CUDA toolkit, no C++ compiler and no GPU.
"""

from __future__ import annotations

import ctypes
import functools
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import KernelError
from . import sources

PATTERNS = (
    "nvidia/*/lib/libnvrtc.so.[0-9]*",
    "torch/lib/libnvrtc*.so*",
    "nvidia/*/bin/nvrtc64_*.dll",
    "nvidia/*/bin/*/nvrtc64_*.dll",
    "torch/lib/nvrtc64_*.dll",
)
"""Where wheels keep the library, below a folder of packages."""

OPTIONS = ("--std=c++17", "--device-as-default-execution-space")


class Nvrtc:
    """The loaded library; `version` is that of CUDA, such as (13, 0)."""

    def __init__(self, path: Path) -> None:
        """Raises OSError if the library cannot be loaded."""
        if sys.platform == "win32":
            os.add_dll_directory(str(path.parent))
        self._library = ctypes.CDLL(str(path))
        major, minor = ctypes.c_int(), ctypes.c_int()
        self._call("nvrtcVersion", ctypes.byref(major), ctypes.byref(minor))
        self.version = (major.value, minor.value)

    def architectures(self) -> list[int]:
        """The compute capabilities that it compiles for, such as 89 for 8.9."""
        count = ctypes.c_int()
        self._call("nvrtcGetNumSupportedArchs", ctypes.byref(count))
        found = (ctypes.c_int * count.value)()
        self._call("nvrtcGetSupportedArchs", found)
        return list(found)

    def compile(self, architecture: int) -> bytes:
        """The kernels' machine code for a compute capability.

        Raises:
            KernelError: the compiler refuses.
        """
        headers = sources.headers()
        texts = [text.encode() for text in headers.values()]
        names = [name.encode() for name in headers]
        options = [f"--gpu-architecture=sm_{architecture}".encode()]
        options += [option.encode() for option in OPTIONS]
        handle = ctypes.c_void_p()
        self._call(
            "nvrtcCreateProgram",
            ctypes.byref(handle),
            sources.program().encode(),
            b"roigs.cu",
            len(names),
            _strings(texts),
            _strings(names),
        )
        try:
            self._compile(handle, options)
            size = ctypes.c_size_t()
            self._call("nvrtcGetCUBINSize", handle, ctypes.byref(size))
            code = ctypes.create_string_buffer(size.value)
            self._call("nvrtcGetCUBIN", handle, code)
            return code.raw
        finally:
            self._library.nvrtcDestroyProgram(ctypes.byref(handle))

    def _compile(self, program: ctypes.c_void_p, options: Sequence[bytes]) -> None:
        try:
            self._call("nvrtcCompileProgram", program, len(options), _strings(options))
        except KernelError as error:
            size = ctypes.c_size_t()
            self._call("nvrtcGetProgramLogSize", program, ctypes.byref(size))
            log = ctypes.create_string_buffer(size.value)
            self._call("nvrtcGetProgramLog", program, log)
            lines = log.value.decode(errors="replace").splitlines()
            first = next((line for line in lines if "error" in line), "no reason given")
            raise KernelError(f"NVRTC cannot compile the kernels ({first}).", error.hint) from error

    def _call(self, name: str, *arguments: Any) -> None:
        failed = int(getattr(self._library, name)(*arguments))
        if failed:
            describe = self._library.nvrtcGetErrorString
            describe.restype = ctypes.c_char_p
            raise KernelError(
                f"{name} failed: {describe(failed).decode()}.", "Report this, or use the CPU."
            )


def _strings(texts: Sequence[bytes]) -> Any:
    return (ctypes.c_char_p * len(texts))(*texts)


def libraries(folders: Sequence[str] | None = None) -> list[Path]:
    """NVRTC libraries in the folders of packages, by default those of this Python."""
    found = []
    for folder in sys.path if folders is None else folders:
        for pattern in PATTERNS:
            found += [
                path
                for path in sorted(Path(folder or ".").glob(pattern))
                if "builtins" not in path.name and ".alt." not in path.name
            ]
    return list(dict.fromkeys(found))


@functools.cache
def load(major: int | None = None) -> Nvrtc:
    """The library; of several, the one of this major version of CUDA.

    Raises:
        KernelError: there is none, or it cannot be loaded.
    """
    found, reason = [], ""
    for path in libraries():
        try:
            found.append(Nvrtc(path))
        except OSError as error:
            reason = str(error)
    if not found:
        raise KernelError(
            f"NVRTC cannot be loaded ({reason})." if reason else "NVRTC is not installed.",
            "Install torch for CUDA with pip: NVRTC comes with it.",
        )
    return max(found, key=lambda nvrtc: (nvrtc.version[0] == major, nvrtc.version))
