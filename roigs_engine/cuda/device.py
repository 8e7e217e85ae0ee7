"""The training device: its choice, its free memory, and uploads that do not wait."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor

from ..context import QUIET, Context
from ..errors import GpuMemoryError, KernelError
from ..formats.events import Device
from ..gpu.program import close_gpu, open_gpu
from . import card

CPU = torch.device("cpu")
GPU = "gpu"
"""Any GPU, used by compute shaders; also `gpu:NAME`. Tensors stay in main memory."""
Check = Callable[[torch.device, Context, bool], None]
"""Raises KernelError if a GPU computes wrong results; with True, also if it is not faster."""


def choose_device(name: str, context: Context = QUIET, check: Check | None = None) -> torch.device:
    """Choose the device for `--device`: `cpu`, `cuda`, `gpu`, `gpu:NAME` or `auto`.

    `auto` takes an NVIDIA GPU, else another GPU if that is faster than the CPU. An event reports
    the device, and the reason. `check` tests our kernels on the GPU before they are used.
    KernelError: a GPU was requested and cannot be used.
    """
    close_gpu()
    kind, _, wanted = name.partition(":")
    reasons = ["chosen"] if kind == "cpu" else []
    for way in ("cuda", GPU):
        if kind not in ("auto", way):
            continue
        try:
            device = check_cuda(context) if way == "cuda" else CPU
            gpu = open_gpu(wanted) if way == GPU else None
            if check is not None:
                check(device, context, kind == "auto")
        except KernelError as error:
            close_gpu()
            if kind == way:
                raise
            reasons.append(error.message.rstrip("."))
        else:
            title = torch.cuda.get_device_name(device) if gpu is None else gpu.adapter.title
            reason = "not checked" if check is None else "checked"
            context.emit(Device(kind=way, name=title, reason=reason))
            return device
    context.emit(Device(kind="cpu", name="", reason=". ".join(reasons)))
    return CPU


def check_cuda(context: Context = QUIET) -> torch.device:
    """The GPU that torch finds; KernelError if there is none, or our kernels do not run on it."""
    if torch.version.cuda is None:
        raise KernelError(
            "This torch is built without CUDA.",
            f"Install torch for CUDA (torch {torch.__version__} is without): docs/cuda.md.",
        )
    if not torch.cuda.is_available():
        raise KernelError("torch finds no NVIDIA GPU.", "Check its driver, or use the CPU.")
    device = torch.device("cuda", torch.cuda.current_device())
    card.prepare(device, context)
    return device


def on_device(state: Any, device: torch.device) -> Any:
    """Copy nested dicts with all tensors on `device`; tensors already there are shared."""
    if isinstance(state, dict):
        return {key: on_device(value, device) for key, value in state.items()}
    return state.to(device) if isinstance(state, Tensor) else state


GIB = 1 << 30
SHARE_OF_PHOTOS = 4  # photos may take 1/4 of the free GPU memory


def card_memory(device: torch.device) -> tuple[int, int]:
    """Bytes of a GPU's memory: how many this process can still use, and the total."""
    free, total = torch.cuda.mem_get_info(device)
    cached = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return free + cached, total


@contextmanager
def explain_out_of_memory(doing: Callable[[], str], advice: str) -> Iterator[None]:
    """Turn torch's out-of-memory error into a GpuMemoryError.

    `doing` describes the work with its numbers; `advice` says what to change.
    """
    try:
        yield
    except torch.OutOfMemoryError as error:
        message = f"The GPU memory is full{_used()}: {doing()}."
        raise GpuMemoryError(message, advice) from error


def smaller_side(width: int, height: int) -> int:
    """A longest side to suggest for photos of (width, height), in pixels: 3/4, at least 64."""
    return max(64, max(width, height) * 3 // 4)


def _used() -> str:
    """The GPU memory in use, in parentheses; empty without a GPU."""
    if not torch.cuda.is_available():
        return ""
    free, total = torch.cuda.mem_get_info()
    ours = torch.cuda.max_memory_allocated()
    return f" ({total / GIB:.1f} GiB, {free / GIB:.1f} free, at most {ours / GIB:.1f} used by this)"


def sent(tensor: Tensor, device: torch.device) -> Tensor:
    """The tensor on `device`; the copy to a GPU goes through pinned memory, in the GPU's queue.

    `tensor.to(device)` would wait until the GPU has finished its queue.
    """
    if device.type == "cpu" or tensor.device.type != "cpu":
        return tensor.to(device)
    return tensor.pin_memory().to(device, non_blocking=True)


@functools.lru_cache(maxsize=4096)
def number(value: float, device: torch.device) -> Tensor:
    """A float32 scalar, created on `device` without a copy. Callers must not change it."""
    return torch.full((), value, dtype=torch.float32, device=device)
