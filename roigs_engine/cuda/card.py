"""Loads the CUDA kernels into a GPU, and launches them on torch's stream."""

from __future__ import annotations

import ctypes
import functools
from contextlib import suppress

import torch

from ..context import QUIET, Context
from ..errors import KernelError
from . import compiler, driver


class Program:
    """The kernels, loaded into a GPU."""

    def __init__(self, device: torch.device, code: bytes) -> None:
        """Raises KernelError if the GPU cannot load the code."""
        self._device, self._driver = device, driver.load()
        torch.cuda.init()  # type: ignore[no-untyped-call]
        index = torch.cuda.current_device() if device.index is None else device.index
        self._context = self._driver.context(index)
        self._driver.enter(self._context)
        self._kernels = self._driver.load(code, compiler.KERNELS)

    def launch(self, kernel: str, blocks: int, threads: int, argument: ctypes.Structure) -> None:
        """Launch a kernel with its argument on the device's current stream."""
        self._driver.enter(self._context)  # autograd's threads have no context of their own
        stream = torch.cuda.current_stream(self._device).cuda_stream
        self._driver.launch(self._kernels[kernel], (blocks, threads), stream, argument)


@functools.cache
def program(device: torch.device) -> Program:
    """Load the kernels for a device; compiles them if they are not cached on disk.

    KernelError: the compiler or driver is missing or too old, or the code cannot be loaded.
    """
    nvrtc = compiler.load()
    driver.load().check_version(nvrtc.version)
    target = compiler.architecture(device, nvrtc)
    try:
        return Program(device, compiler.machine_code(nvrtc, target))
    except KernelError:
        with suppress(OSError):
            compiler.cached(nvrtc, target).unlink()  # a damaged file would fail each time
        raise


def prepare(device: torch.device, context: Context = QUIET) -> None:
    """Compile for a device if necessary, after a message; raises as `program`."""
    nvrtc = compiler.load()
    if not compiler.cached(nvrtc, compiler.architecture(device, nvrtc)).is_file():
        context.info("Compiling the GPU kernels for this card, once: some seconds.")
    program(device)
