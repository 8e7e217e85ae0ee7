"""Where to work: on the CPU or on an NVIDIA card. The one place that decides."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..context import QUIET, Context
from ..errors import KernelError
from . import library

CPU = torch.device("cpu")


def choose_device(name: str, context: Context = QUIET) -> torch.device:
    """The device for `--device`: "cpu", "cuda", or "auto", the card where one can be used.

    A message says why "auto" takes the CPU.

    Raises:
        KernelError: "cuda" was asked for and cannot be had.
    """
    if name == "cpu":
        return CPU
    try:
        check_cuda()
    except KernelError as error:
        if name == "cuda":
            raise
        context.info(f"Working on the CPU: {error.message}")
        return CPU
    device = torch.device("cuda", torch.cuda.current_device())
    context.info(f"Working on {torch.cuda.get_device_name(device)}.")
    return device


def check_cuda() -> None:
    """Raises KernelError unless torch has a card and gsplat can draw on it."""
    if torch.version.cuda is None:
        raise KernelError("This torch is built without CUDA.", library.how_to_install())
    if not torch.cuda.is_available():
        raise KernelError("torch finds no NVIDIA card.", "Look after its driver, or use the CPU.")
    library.gsplat()


def on_device(state: Any, device: torch.device) -> Any:
    """The same nested dicts with their tensors on `device`; what is there already is shared."""
    if isinstance(state, dict):
        return {key: on_device(value, device) for key, value in state.items()}
    return state.to(device) if isinstance(state, Tensor) else state
