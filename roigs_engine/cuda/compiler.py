"""Compiles the sources of the CUDA kernels with NVRTC, NVIDIA's run-time compiler.

NVRTC is a library in torch's CUDA wheels, and also a separate wheel. It needs no CUDA toolkit, no
C++ compiler and no GPU. It gets the sources from memory: one program, and headers by name. It has
no standard library, and a different `simd.h`, with one Gaussian per thread. Machine code is cached
on disk.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch

from ..errors import KernelError, RunFolderError
from ..formats.files import atomic_write
from ..kernels.build import SOURCE_FOLDER as SHARED_FOLDER
from ..kernels.library import refuse_others_code, user_cache

FOLDER = Path(__file__).parent / "kernels"
PROGRAMS = (
    *("project.cu", "blend.cu", "weigh.cu", "gradient.cu", "surface.cu", "backward.cu", "loss.cu"),
)
SHARED = (
    "constants.h",
    "types.h",
    "sh.h",
    "light.h",
    "ellipses.h",
    "geometry.h",
    "geometry_gradient.h",
    "plane.h",
)
KERNELS = (
    *("place_camera", "project", "list_tiles", "begin_tiles", "begin_groups"),
    *("blend", "median_depth", "weigh", "fold_weights", "gradient"),
    *("project_planes", "blend_surface", "surface_gradient"),
    *("project_backward", "project_backward_adam", "loss", "loss_gradient", "loss_terms"),
)
"""The names of all kernels."""

PATTERNS = (
    "nvidia/*/lib/libnvrtc.so.[0-9]*",
    "torch/lib/libnvrtc*.so*",
    "nvidia/*/bin/nvrtc64_*.dll",
    "nvidia/*/bin/*/nvrtc64_*.dll",
    "torch/lib/nvrtc64_*.dll",
)
"""Paths of the library in wheels, below a folder of packages."""
OPTIONS = ("--std=c++17", "--device-as-default-execution-space")
_INTEGERS = """#pragma once
typedef signed char int8_t;
typedef unsigned char uint8_t;
typedef short int16_t;
typedef int int32_t;
typedef unsigned int uint32_t;
typedef long long int64_t;
typedef unsigned long long uint64_t;
"""


def source_text() -> str:
    """The source of the program, which includes all kernels."""
    return "".join(f'#include "{name}"\n' for name in PROGRAMS)


@functools.cache
def headers() -> dict[str, str]:
    """Name -> text of every file that `source_text` includes, directly or not."""
    own = [path for path in sorted(FOLDER.iterdir()) if path.suffix != ".md"]
    paths = [*own, *(SHARED_FOLDER / name for name in SHARED)]
    found = {path.name: path.read_text(encoding="utf-8") for path in paths}
    scalar = '#pragma once\n#include "scalar.h"\n'
    return found | {"simd.h": scalar, "simd_rows.h": scalar, "cstdint": _INTEGERS}


@functools.cache
def source_key() -> str:
    """A hash of the sources."""
    digest = hashlib.sha256(source_text().encode())
    for name, text in headers().items():
        digest.update(f"{name}\0{text}\0".encode())
    return digest.hexdigest()[:16]


class Nvrtc:
    """The loaded library; `version` is its CUDA version, such as (13, 0)."""

    def __init__(self, path: Path) -> None:
        """Raises OSError if the library cannot be loaded."""
        if sys.platform == "win32":
            os.add_dll_directory(str(path.parent))
        self._library = ctypes.CDLL(str(path))
        major, minor = ctypes.c_int(), ctypes.c_int()
        self._call("nvrtcVersion", ctypes.byref(major), ctypes.byref(minor))
        self.version = (major.value, minor.value)

    def architectures(self) -> list[int]:
        """The compute capabilities that it supports, such as 89 for 8.9."""
        count = ctypes.c_int()
        self._call("nvrtcGetNumSupportedArchs", ctypes.byref(count))
        found = (ctypes.c_int * count.value)()
        self._call("nvrtcGetSupportedArchs", found)
        return list(found)

    def compile(self, architecture: int) -> bytes:
        """Compile the kernels to machine code for a compute capability; KernelError: it fails."""
        options = [f"--gpu-architecture=sm_{architecture}", *OPTIONS]
        handle = ctypes.c_void_p()
        self._call(
            "nvrtcCreateProgram",
            ctypes.byref(handle),
            source_text().encode(),
            b"roigs.cu",
            len(headers()),
            _strings(headers().values()),
            _strings(headers()),
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

    def _compile(self, program: ctypes.c_void_p, options: Sequence[str]) -> None:
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


def _strings(texts: Iterable[str]) -> Any:
    encoded = [text.encode() for text in texts]
    return (ctypes.c_char_p * len(encoded))(*encoded)


def libraries() -> list[Path]:
    """Find NVRTC libraries in this Python's folders of packages."""
    found = [
        path
        for folder in filter(os.path.isabs, sys.path)
        for pattern in PATTERNS
        for path in sorted(Path(folder).glob(pattern))
        if "builtins" not in path.name and ".alt." not in path.name
    ]
    return list(dict.fromkeys(found))


@functools.cache
def load() -> Nvrtc:
    """Load NVRTC: of several, the one with torch's major version of CUDA, else the newest.

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
    major = (torch.version.cuda or "").partition(".")[0]
    return max(found, key=lambda nvrtc: (str(nvrtc.version[0]) == major, nvrtc.version))


def machine_code(compiler: Nvrtc, target: int) -> bytes:
    """The kernels' machine code for a compute capability, from the cache or compiled now."""
    path = cached(compiler, target)
    refuse_others_code(path)
    with suppress(OSError):
        return path.read_bytes()
    code = compiler.compile(target)
    with suppress(RunFolderError), atomic_write(path, durable=False) as file:
        file.write(code)  # if this fails, the next start compiles again
    return code


def cached(compiler: Nvrtc, target: int) -> Path:
    """The cache path of compiled kernels, by source, compute capability and compiler."""
    version = ".".join(map(str, compiler.version))
    return user_cache() / "cuda" / f"{source_key()}-sm_{target}-nvrtc-{version}.cubin"


def architecture(device: torch.device, compiler: Nvrtc) -> int:
    """The newest compute capability that the compiler supports and the GPU runs, or KernelError."""
    major, minor = torch.cuda.get_device_capability(device)
    known = compiler.architectures()
    usable = [known for known in known if known // 10 == major and known % 10 <= minor]
    if not usable:
        version = ".".join(map(str, compiler.version))
        raise KernelError(
            f"CUDA {version} does not compile for this card (compute capability {major}.{minor}).",
            "Install torch for a newer CUDA." if 10 * major > max(known) else "Use the CPU.",
        )
    return max(usable)
