"""The packages that compute on the card, found when first used; their absence in one line.

gsplat (Apache-2.0) is called by the names and arguments of its version 1.5.3, as its documentation
has them (docs/cuda.md). Its wheel holds CUDA sources, which it compiles at first use.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import importlib.util
import inspect
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
"""What is called of gsplat, and the arguments that are passed, all by name."""


@functools.cache
def gsplat() -> Any:
    """gsplat, its kernels compiled.

    Raises:
        KernelError: it is not there, has another interface, or cannot be compiled.
    """
    try:
        # It reports its compilation on standard output, where our events go.
        with contextlib.redirect_stdout(sys.stderr):
            module = importlib.import_module("gsplat")
            compiled = importlib.import_module("gsplat.cuda._backend")._C
    except ImportError as error:
        missing = error.name or "gsplat"
        raise KernelError(f"{missing} is not installed.", how_to_install()) from error
    except Exception as error:  # of compilers there are many kinds
        because = str(error).strip().partition("\n")[0]
        raise KernelError(
            f"gsplat could not compile its kernels ({because}).", how_to_install()
        ) from error
    if compiled is None:
        raise KernelError("gsplat found no CUDA toolkit to compile with.", how_to_install())
    check_interface(module)
    return module


def check_interface(module: Any) -> None:
    """Raises KernelError unless the module has what is called of it (`CALLS`)."""
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
    """One line: gsplat for the torch at hand."""
    version, cuda = torch.__version__.partition("+")[0], torch.version.cuda
    if cuda is None:
        return f"Install a torch for CUDA (this one, {torch.__version__}, is not), then gsplat."
    if tuple(map(int, version.split(".")[:2])) <= (2, 4):
        return (
            f"gsplat's own index has wheels for this torch: gsplat {GSPLAT}"
            f"+pt{''.join(version.split('.')[:2])}cu{cuda.replace('.', '')} (docs/cuda.md)."
        )
    return (
        f"pip install gsplat=={GSPLAT}; it compiles at first use, which needs the CUDA toolkit"
        f" {cuda} (nvcc) and a C++ compiler."
    )


def has_triton() -> bool:
    """Whether kernels in Triton can be used (it comes with torch for CUDA on Linux)."""
    return importlib.util.find_spec("triton") is not None


def has_blending_weights(device: torch.device) -> bool:
    """Whether Gaussians there can be drawn with their blending weights (`with_max_weight`)."""
    return device.type != "cuda" or has_triton()


@functools.cache
def fused_ssim() -> Callable[[Tensor, Tensor], Tensor] | None:
    """Mean SSIM of (1, 3, H, W) values, differentiable in the first; None: not installed."""
    try:
        found: Callable[[Tensor, Tensor], Tensor] = importlib.import_module("fused_ssim").fused_ssim
    except (ImportError, AttributeError):
        return None
    return found
