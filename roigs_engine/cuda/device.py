"""Chooses the device: the CPU or an NVIDIA GPU."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..context import QUIET, Context
from ..errors import KernelError
from ..formats.events import Device
from . import card

CPU = torch.device("cpu")


Check = Callable[[torch.device, Context], None]
"""Raises KernelError if a GPU computes what it should not."""


def choose_device(name: str, context: Context = QUIET, check: Check | None = None) -> torch.device:
    """The device for `--device`: "cpu", "cuda", or "auto", the GPU if one can be used.

    An event says which one it is, and why.

    Args: `check`: tests our kernels on the GPU, before they are used.

    Raises:
        KernelError: "cuda" was requested and cannot be used.
    """
    if name == "cpu":
        context.emit(Device(kind="cpu", name="", reason="chosen"))
        return CPU
    try:
        device = check_cuda(context)
        if check is not None:
            check(device, context)
    except KernelError as error:
        if name == "cuda":
            raise
        context.emit(Device(kind="cpu", name="", reason=error.message.rstrip(".")))
        return CPU
    reason = "not checked" if check is None else "checked"
    context.emit(Device(kind="cuda", name=torch.cuda.get_device_name(device), reason=reason))
    return device


def check_cuda(context: Context = QUIET) -> torch.device:
    """The GPU that torch finds; KernelError unless it has one, and kernels that draw on it."""
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
    """The same nested dicts with their tensors on `device`; tensors already there are shared."""
    if isinstance(state, dict):
        return {key: on_device(value, device) for key, value in state.items()}
    return state.to(device) if isinstance(state, Tensor) else state
