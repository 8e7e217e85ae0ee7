"""The packages that compute on the GPU, imported on first use; a missing one gives a clear error.

gsplat (Apache-2.0) is called with the names and arguments of version 1.5.3 (docs/cuda.md). Its
wheel contains CUDA sources and compiles them on first use.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..errors import KernelError

GSPLAT = "1.5.3"
CALLS = {
    "fully_fused_projection": (
        *("means", "covars", "quats", "scales", "viewmats", "Ks", "width", "height"),
        *("eps2d", "near_plane", "opacities"),
    ),
    "spherical_harmonics": ("degrees_to_use", "dirs", "coeffs", "masks"),
    "isect_tiles": ("means2d", "radii", "depths", "tile_size", "tile_width", "tile_height"),
    "isect_offset_encode": ("isect_ids", "n_images", "tile_width", "tile_height"),
    "rasterize_to_pixels": (
        *("means2d", "conics", "colors", "opacities", "image_width", "image_height", "tile_size"),
        *("isect_offsets", "flatten_ids", "backgrounds", "masks"),
    ),
}
"""The gsplat functions that are used, and the arguments that are passed, all by name."""


KERNELS_VARIABLE = "ROIGS_CUDA_KERNELS"


def own_kernels() -> bool:
    """Whether our kernels draw on the GPU; ROIGS_CUDA_KERNELS=gsplat chooses gsplat's."""
    return os.environ.get(KERNELS_VARIABLE, "") != "gsplat"


@functools.cache
def gsplat() -> Any:
    """gsplat with compiled kernels.

    Raises:
        KernelError: it is not installed, has another interface, or cannot be compiled.
    """
    try:
        # gsplat prints compiler messages to standard output, which is for our events.
        with contextlib.redirect_stdout(sys.stderr):
            module = importlib.import_module("gsplat")
            compiled = importlib.import_module("gsplat.cuda._backend")._C
    except ImportError as error:
        missing = error.name or "gsplat"
        raise KernelError(f"{missing} is not installed.", how_to_install()) from error
    except Exception as error:  # compilers fail in many ways
        because = str(error).strip().partition("\n")[0]
        raise KernelError(
            f"gsplat could not compile its kernels ({because}).", how_to_install()
        ) from error
    if compiled is None:
        raise KernelError("gsplat found no CUDA toolkit to compile with.", how_to_install())
    check_interface(module)
    return module


def check_interface(module: Any) -> None:
    """Raise KernelError unless the module has the functions and arguments of `CALLS`."""
    for name, arguments in CALLS.items():
        function = getattr(module, name, None)
        known = inspect.signature(function).parameters if callable(function) else {}
        if not set(arguments) <= set(known):
            version = getattr(module, "__version__", "?")
            raise KernelError(
                f"gsplat {version} has no {name}({', '.join(arguments)}).",
                f"Install the version this engine was written for: pip install gsplat=={GSPLAT}",
            )


def how_to_install() -> str:
    """A hint: how to install gsplat for the installed torch."""
    version, cuda = torch.__version__.partition("+")[0], torch.version.cuda
    if cuda is None:
        return f"Install torch for CUDA (torch {torch.__version__} is without): docs/cuda.md."
    if tuple(map(int, version.split(".")[:2])) <= (2, 4):
        return (
            f"Install a wheel for this torch from gsplat's own index: gsplat {GSPLAT}"
            f"+pt{''.join(version.split('.')[:2])}cu{cuda.replace('.', '')} (docs/cuda.md)."
        )
    return (
        f"Run pip install gsplat=={GSPLAT}; it compiles on first use, which needs the CUDA toolkit"
        f" {cuda} (nvcc) and a C++ compiler."
    )


def has_triton() -> bool:
    """Whether Triton is installed (torch for CUDA on Linux includes it)."""
    return importlib.util.find_spec("triton") is not None


def has_blending_weights(device: torch.device) -> bool:
    """Whether rendering on the device can return blending weights (`with_max_weight`)."""
    return device.type != "cuda" or own_kernels() or has_triton()


def has_median_depth(device: torch.device) -> bool:
    """Whether rendering on the device can return the median depth."""
    return device.type != "cuda" or own_kernels()


@functools.cache
def fused_ssim() -> Callable[[Tensor, Tensor], Tensor] | None:
    """fused-ssim's mean SSIM of two (1, 3, H, W) tensors, differentiable in the first.

    None: fused-ssim is not installed.
    """
    try:
        found: Callable[[Tensor, Tensor], Tensor] = importlib.import_module("fused_ssim").fused_ssim
    except (ImportError, AttributeError):
        return None
    return found
