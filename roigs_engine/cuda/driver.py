"""NVIDIA's driver: loads machine code into torch's context, launches kernels on its stream.

The driver is a library of the system, loaded with ctypes when it is first used.
"""

from __future__ import annotations

import ctypes
import functools
import sys
from typing import Any

from ..errors import GpuMemoryError, KernelError

LIBRARY = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"
FULL = 2  # CUDA_ERROR_OUT_OF_MEMORY
OTHER_CARD = (200, 209, 222)  # invalid image, no binary for this card, unsupported PTX


class Driver:
    """The loaded driver; `version` is the newest CUDA it supports, such as (13, 0)."""

    def __init__(self, library: Any) -> None:
        """Raises KernelError if the driver does not start."""
        self._library = library
        self.call("cuInit", 0)
        version = ctypes.c_int()
        self.call("cuDriverGetVersion", ctypes.byref(version))
        self.version = (version.value // 1000, version.value % 1000 // 10)

    def check_version(self, cuda: tuple[int, int]) -> None:
        """Raise KernelError if the driver cannot run code of a newer major version of CUDA."""
        if cuda[0] > self.version[0]:
            raise KernelError(
                f"The NVIDIA driver is for CUDA {self.version[0]}.{self.version[1]}; the kernels"
                f" are compiled by CUDA {cuda[0]}.{cuda[1]}.",
                "Update the NVIDIA driver, or install torch for an older CUDA.",
            )

    def context(self, index: int) -> ctypes.c_void_p:
        """The context that torch uses on a device; it is kept alive."""
        device, context = ctypes.c_int(), ctypes.c_void_p()
        self.call("cuDeviceGet", ctypes.byref(device), index)
        self.call("cuDevicePrimaryCtxRetain", ctypes.byref(context), device)
        return context

    def enter(self, context: ctypes.c_void_p) -> None:
        """Make a context this thread's current one, unless it already is."""
        current = ctypes.c_void_p()
        self.call("cuCtxGetCurrent", ctypes.byref(current))
        if current.value != context.value:
            self.call("cuCtxSetCurrent", context)

    def load(self, code: bytes, kernels: tuple[str, ...]) -> dict[str, ctypes.c_void_p]:
        """Load machine code into the thread's context; returns name -> kernel."""
        module = ctypes.c_void_p()
        self.call("cuModuleLoadData", ctypes.byref(module), code)
        found = {}
        for name in kernels:
            found[name] = ctypes.c_void_p()
            self.call("cuModuleGetFunction", ctypes.byref(found[name]), module, name.encode())
        return found

    def launch(
        self,
        kernel: ctypes.c_void_p,
        sizes: tuple[int, int],  # blocks, threads of each
        stream: int,
        argument: ctypes.Structure,
    ) -> None:
        """Launch a kernel with its only argument."""
        arguments = (ctypes.c_void_p * 1)(ctypes.addressof(argument))
        blocks, threads = sizes
        grid = (blocks, 1, 1, threads, 1, 1, 0)
        self.call("cuLaunchKernel", kernel, *grid, ctypes.c_void_p(stream), arguments, None)

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function of the driver; KernelError if it fails."""
        failed = int(getattr(self._library, name)(*arguments))
        if not failed:
            return
        text = ctypes.c_char_p()
        self._library.cuGetErrorString(failed, ctypes.byref(text))
        reason = (text.value or b"unknown error").decode(errors="replace")
        if failed == FULL:
            raise GpuMemoryError(
                "The GPU memory is full.", "Close other programs that use the GPU, or use the CPU."
            )
        hint = "Restart the computer or update the NVIDIA driver, or use the CPU."
        if failed in OTHER_CARD:
            hint = "Update the NVIDIA driver, or use the CPU."
        raise KernelError(f"NVIDIA driver: {name} failed ({failed}, {reason}).", hint)


@functools.cache
def load() -> Driver:
    """Load the system's driver; KernelError if there is none, or it does not start."""
    try:
        library = ctypes.CDLL(LIBRARY)
    except OSError as error:
        raise KernelError(
            "There is no NVIDIA driver.", "Install it from nvidia.com, or use the CPU."
        ) from error
    return Driver(library)


@functools.cache
def build() -> str:
    """The version of the driver itself, such as 580.95.05; empty if it is unknown."""
    name = "nvml.dll" if sys.platform == "win32" else "libnvidia-ml.so.1"
    version = ctypes.create_string_buffer(96)
    try:
        management = ctypes.CDLL(name)
        if management.nvmlInit_v2() or management.nvmlSystemGetDriverVersion(version, 96):
            return ""
    except (OSError, AttributeError):
        return ""
    return version.value.decode(errors="replace")
