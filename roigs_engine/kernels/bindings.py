"""The kernels' C interface (roigs.h) in ctypes: structures, signatures, error codes."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from . import library

if TYPE_CHECKING:
    from torch import Tensor

OUT_OF_MEMORY, TOO_MANY_INTERSECTIONS = -1, -2  # roigs.h: Failure

_ADDRESS = ctypes.c_void_p
_COUNT = ctypes.c_int64
_PARAMETERS = ("means", "quats", "scales", "opacities", "sh")


class Gaussians(ctypes.Structure):
    """roigs.h: struct Gaussians."""

    _fields_ = [
        *((name, _ADDRESS) for name in _PARAMETERS),
        ("count", _COUNT),
        ("sh_coefficients", ctypes.c_int32),
        ("sh_degree", ctypes.c_int32),
        ("raw", ctypes.c_int32),
        ("linear_light", ctypes.c_int32),
    ]


def packed_gaussians(
    parameters: Sequence[Tensor], sh_degree: int, raw: bool, linear_light: bool
) -> Gaussians:
    """Pack contiguous means, quats, scales, opacities and SH; the caller must keep them alive."""
    addresses = (parameter.data_ptr() for parameter in parameters)
    sizes = len(parameters[0]), parameters[4].shape[1]
    return Gaussians(*addresses, *sizes, sh_degree, raw, linear_light)


class Gradients(ctypes.Structure):
    """roigs.h: struct Gradients."""

    _fields_ = [(name, _ADDRESS) for name in _PARAMETERS]


class Camera(ctypes.Structure):
    """roigs.h: struct Camera."""

    _fields_ = [
        ("world_to_camera", ctypes.c_float * 12),
        ("position", ctypes.c_float * 3),
        ("focal_and_centre", ctypes.c_float * 4),
        ("background", ctypes.c_float * 3),
        ("blur", ctypes.c_float * 2),
        ("max_slope", ctypes.c_float),
        ("min_sigmas", ctypes.c_float),
        ("min_transmittance", ctypes.c_float),
        ("size", ctypes.c_int32 * 2),
        ("tiles", ctypes.c_int32 * 4),
        ("window", ctypes.c_int32 * 4),
        ("tile_mask", _ADDRESS),
    ]


class Outputs(ctypes.Structure):
    """roigs.h: struct Outputs."""

    _fields_ = [
        (name, _ADDRESS)
        for name in (
            *("image", "alpha", "depth", "max_weight", "weight_sum", "pixel_weights"),
            "surface",
        )
    ]


class OutputGradients(ctypes.Structure):
    """roigs.h: struct OutputGradients."""

    _fields_ = [("image", _ADDRESS), ("surface", _ADDRESS)]


class AdamParameter(ctypes.Structure):
    """roigs.h: struct AdamParameter."""

    _fields_ = [
        *((n, _ADDRESS) for n in ("values", "exp_avg", "exp_avg_sq", "gradient", "rates")),
        ("width", _COUNT),
    ]


class Adam(ctypes.Structure):
    """roigs.h: struct Adam."""

    _fields_ = [
        ("parameters", ctypes.POINTER(AdamParameter)),
        ("count", _COUNT),
        ("betas", ctypes.c_double * 2),
        ("epsilon", ctypes.c_double),
        ("step", _COUNT),
        ("row_rates", _ADDRESS),
    ]


class DepthPhoto(ctypes.Structure):
    """roigs.h: struct DepthPhoto."""

    _fields_ = [
        *((name, _ADDRESS) for name in ("depth", "weight", "slope")),
        ("pose", ctypes.c_float * 12),
        ("lens", ctypes.c_float * 4),
        *((name, ctypes.c_float) for name in ("jump", "truncation", "footprints")),
        ("size", ctypes.c_int32 * 2),
    ]


# Name -> type of the result, types of the arguments.
SIGNATURES: dict[str, tuple[Any, list[Any]]] = {
    "roigs_view_create": (_ADDRESS, []),
    "roigs_view_destroy": (None, [_ADDRESS]),
    "roigs_project": (_COUNT, [_ADDRESS] * 4),  # view, Gaussians, Camera, visible
    "roigs_bin": (_COUNT, [_ADDRESS]),
    "roigs_project_planes": (_COUNT, [_ADDRESS] * 2),  # view, Gaussians
    "roigs_render": (_COUNT, [_ADDRESS] * 2),  # view, Outputs
    "roigs_median_depth": (None, [_ADDRESS] * 3),  # view, alpha, depth
    "roigs_pair_evaluations": (_COUNT, [_ADDRESS]),
    "roigs_render_backward": (_COUNT, [_ADDRESS] * 3),  # view, Outputs, OutputGradients
    "roigs_project_backward": (None, [_ADDRESS] * 4),  # view, Gaussians, Gradients, grad2d
    "roigs_project_backward_adam": (_COUNT, [_ADDRESS] * 4),  # view, Gaussians, Adam, grad2d
    "roigs_adam": (_COUNT, [_COUNT, _ADDRESS, _ADDRESS]),  # rows, Adam, visible
    # matrix, rows, width, chosen, count, out
    "roigs_copy_rows": (None, [_ADDRESS, _COUNT, _COUNT, _ADDRESS, _COUNT, _ADDRESS]),
    # triangles, count, lens, near, width, height, depth
    "roigs_surface_depth": (
        None,
        [_ADDRESS, _COUNT, _ADDRESS, ctypes.c_double, _COUNT, _COUNT, _ADDRESS],
    ),
    "roigs_fuse_depth": (None, [_ADDRESS, _COUNT, *[_ADDRESS] * 2]),  # points, count, photo, sums
    # grey, width, height, centres, shapes, count, half, weights; patches, deviations, inside
    "roigs_patches": (
        None,
        [_ADDRESS, *[_COUNT] * 2, *[_ADDRESS] * 2, *[_COUNT] * 2, *[_ADDRESS] * 4],
    ),
    # width, height; image (3, height, width), target (height, width, 3), weights (height, width) or
    # null; SSIM's weight; gradient (3, height, width) or null, result: loss, L1, SSIM as doubles
    "roigs_photo_loss": (
        None,
        [_COUNT, _COUNT, *[_ADDRESS] * 3, ctypes.c_float, *[_ADDRESS] * 2],
    ),
}


def bound(kernels: ctypes.CDLL) -> ctypes.CDLL:
    """Set the signatures of the library's functions; returns the library."""
    for name, (result, arguments) in SIGNATURES.items():
        function = getattr(kernels, name)
        function.restype, function.argtypes = result, arguments
    return kernels


@functools.cache
def kernels() -> ctypes.CDLL:
    """Load the compiled kernels for this processor; KernelError if there are none."""
    return bound(library.load())


def pointer(tensor: Tensor | None) -> int | None:
    """The address of a CPU tensor's first element, as a c_void_p argument; null for None.

    The caller must check shape, type and strides, and keep the tensor alive during the call.
    """
    if tensor is None:
        return None
    assert tensor.is_cpu, "kernels take tensors in main memory"
    return tensor.data_ptr()
