"""The kernels on a card: compiled for it once, kept on disk, launched on torch's stream."""

from __future__ import annotations

import ctypes
import functools
from contextlib import suppress
from pathlib import Path
from typing import Protocol

import torch

from ..context import QUIET, Context
from ..errors import KernelError, RunFolderError
from ..formats.files import atomic_write
from ..kernels.library import user_cache
from . import driver, nvrtc, sources


class Program(Protocol):
    """Kernels that can be launched."""

    def launch(self, kernel: str, blocks: int, threads: int, argument: ctypes.Structure) -> None:
        """Start a kernel with its argument, after what runs on the device's current stream."""
        ...


class CardProgram:
    """The kernels in a card's memory."""

    def __init__(self, device: torch.device, code: bytes) -> None:
        """Raises KernelError if the card does not take the code."""
        self._device, self._driver = device, driver.load()
        torch.cuda.init()  # type: ignore[no-untyped-call]
        index = torch.cuda.current_device() if device.index is None else device.index
        self._context = self._driver.context(index)
        self._driver.enter(self._context)
        self._kernels = self._driver.load(code, sources.KERNELS)

    def launch(self, kernel: str, blocks: int, threads: int, argument: ctypes.Structure) -> None:
        """See `Program`."""
        self._driver.enter(self._context)  # autograd's threads have none of their own
        stream = torch.cuda.current_stream(self._device).cuda_stream
        self._driver.launch(self._kernels[kernel], (blocks, threads), stream, argument)


@functools.cache
def program(device: torch.device) -> Program:
    """The kernels for a device; compiled, where they are not on disk.

    Raises:
        KernelError: no compiler, no driver, or one too old; or the code cannot be loaded.
    """
    compiler = nvrtc_of_torch()
    driver.load().check_version(compiler.version)
    target = architecture(device, compiler)
    try:
        return CardProgram(device, machine_code(compiler, target))
    except KernelError:
        with suppress(OSError):
            cached(compiler, target).unlink()  # were it damaged, it would fail each time
        raise


def prepare(device: torch.device, context: Context = QUIET) -> None:
    """Compile for a device, unless that is done; a message says so before it starts.

    Raises:
        KernelError: as `program`.
    """
    compiler = nvrtc_of_torch()
    if not cached(compiler, architecture(device, compiler)).is_file():
        context.info("Compiling the GPU kernels for this card, once: some seconds.")
    program(device)


def machine_code(compiler: nvrtc.Nvrtc, target: int) -> bytes:
    """The kernels for a compute capability, from disk if they were compiled before."""
    path = cached(compiler, target)
    with suppress(OSError):
        return path.read_bytes()
    code = compiler.compile(target)
    with suppress(RunFolderError), atomic_write(path, durable=False) as file:
        file.write(code)  # if it cannot be written, it is compiled again next time
    return code


def cached(compiler: nvrtc.Nvrtc, target: int) -> Path:
    """Where compiled kernels are kept: by source, compute capability and compiler."""
    version = ".".join(map(str, compiler.version))
    return user_cache() / "cuda" / f"{sources.source_key()}-sm_{target}-nvrtc-{version}.cubin"


def architecture(device: torch.device, compiler: nvrtc.Nvrtc) -> int:
    """The newest compute capability of the compiler whose code runs on a card.

    Raises:
        KernelError: there is none.
    """
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


def nvrtc_of_torch() -> nvrtc.Nvrtc:
    """The compiler of torch's version of CUDA, or the newest. Raises KernelError."""
    cuda = torch.version.cuda
    return nvrtc.load(int(cuda.partition(".")[0]) if cuda else None)
