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
    """The kernels in a card's memory."""

    def __init__(self, device: torch.device, code: bytes) -> None:
        """Raises KernelError if the card does not take the code."""
        self._device, self._driver = device, driver.load()
        torch.cuda.init()  # type: ignore[no-untyped-call]
        index = torch.cuda.current_device() if device.index is None else device.index
        self._context = self._driver.context(index)
        self._driver.enter(self._context)
        self._kernels = self._driver.load(code, compiler.KERNELS)

    def launch(self, kernel: str, blocks: int, threads: int, argument: ctypes.Structure) -> None:
        """Start a kernel with its argument, after what runs on the device's current stream."""
        self._driver.enter(self._context)  # autograd's threads have none of their own
        stream = torch.cuda.current_stream(self._device).cuda_stream
        self._driver.launch(self._kernels[kernel], (blocks, threads), stream, argument)


@functools.cache
def program(device: torch.device) -> Program:
    """The kernels for a device; compiled, where they are not on disk.

    KernelError: no compiler, no driver, or one too old; or the code cannot be loaded.
    """
    nvrtc = compiler.load()
    driver.load().check_version(nvrtc.version)
    target = compiler.architecture(device, nvrtc)
    try:
        return Program(device, compiler.machine_code(nvrtc, target))
    except KernelError:
        with suppress(OSError):
            compiler.cached(nvrtc, target).unlink()  # were it damaged, it would fail each time
        raise


def prepare(device: torch.device, context: Context = QUIET) -> None:
    """Compile for a device, unless that is done; a message says so first. KernelError as above."""
    nvrtc = compiler.load()
    if not compiler.cached(nvrtc, compiler.architecture(device, nvrtc)).is_file():
        context.info("Compiling the GPU kernels for this card, once: some seconds.")
    program(device)
