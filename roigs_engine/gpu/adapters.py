"""The GPUs that wgpu finds, and the one in use.

wgpu is a package with a library that uses GPUs through their drivers: Vulkan, Metal or DirectX 12.
torch does not support these GPUs, so its tensors stay in main memory.
"""

from __future__ import annotations

import functools
import os
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from ..errors import KernelError

APIS = {"Vulkan": "Vulkan", "Metal": "Metal", "D3D12": "DirectX 12"}
"""wgpu's backends with all features that the shaders need -> names for users."""
STORAGE_BUFFERS = 10
"""Most buffers of a kernel."""


@dataclass(frozen=True, kw_only=True)
class Adapter:
    """A GPU with its driver."""

    handle: Any  # wgpu.GPUAdapter
    name: str
    api: str
    driver: str  # with its version
    is_software: bool  # emulated by the processor
    is_integrated: bool

    @property
    def title(self) -> str:
        """Its name and its API, for users."""
        return f"{self.name}, {self.api}"

    @property
    def largest(self) -> int:
        """The largest buffer that a kernel can use, bytes."""
        limits = self.handle.limits
        return min(int(limits["max-storage-buffer-binding-size"]), int(limits["max-buffer-size"]))

    @property
    def gaussians(self) -> int:
        """The number of Gaussians with SH of degree 3 that fit into the largest buffer."""
        return self.largest // (4 * 48)


@functools.cache
def wgpu() -> Any:
    """Import the package; KernelError if it is not installed, or does not load."""
    try:
        import wgpu
        from wgpu.backends.wgpu_native.extras import set_instance_extras

        if "XDG_RUNTIME_DIR" not in os.environ:  # without a desktop, a layer of Mesa prints errors
            os.environ.setdefault("NODEVICE_SELECT", "1")
        with suppress(RuntimeError):  # other code in this process has already listed the GPUs
            # Without OpenGL, which writes to the terminal.
            set_instance_extras(backends=("Vulkan", "Metal", "DX12"))
    except (ImportError, OSError, RuntimeError) as error:
        reason = "" if isinstance(error, ModuleNotFoundError) else f" ({error})"
        raise KernelError(
            f"Other GPUs need the Python package wgpu, which is missing{reason}.",
            "Install it: pip install 'roigs[gpu]'.",
        ) from error
    return wgpu


@functools.cache
def adapters() -> tuple[Adapter, ...]:
    """All GPUs, best first: those with their own memory. KernelError: wgpu is missing."""
    found = []
    for handle in wgpu().gpu.enumerate_adapters_sync():
        info = handle.info
        if info["backend_type"] not in APIS:
            continue
        kind = info["adapter_type"]
        found.append(
            Adapter(
                handle=handle,
                name=info["device"] or info["description"],
                api=APIS[info["backend_type"]],
                driver=info["description"],
                is_software=kind == "CPU",
                is_integrated=kind != "DiscreteGPU",
            )
        )
    # A GPU with two APIs is listed twice. DirectX's old compiler refuses much that others accept.
    return tuple(sorted(found, key=lambda e: (e.is_software, e.is_integrated, "X" in e.api)))


def find(name: str = "") -> Adapter:
    """The best GPU; with `name`, the first one of any kind whose title contains it.

    GPUs emulated by the processor must be named, because they are slower than our CPU kernels.
    KernelError: there is no such GPU.
    """
    there = adapters()
    wanted = [
        each
        for each in there
        if (name.casefold() in each.title.casefold() if name else not each.is_software)
    ]
    if not wanted:
        names = "; ".join(each.title for each in there)
        raise KernelError(
            f"There is no GPU named '{name}'." if name else "wgpu finds no GPU.",
            f"It finds: {names}." if names else "Check its driver: it must have Vulkan.",
        )
    few = int(wanted[0].handle.limits["max-storage-buffers-per-shader-stage"])
    if few < STORAGE_BUFFERS:
        raise KernelError(
            f"{wanted[0].title} takes {few} buffers per kernel; {STORAGE_BUFFERS} are needed.",
            "Update its driver, or use the CPU.",
        )
    return wanted[0]


def is_any() -> bool:
    """Whether `find` finds a GPU."""
    try:
        find()
    except KernelError:
        return False
    return True
