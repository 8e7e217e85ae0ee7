"""ctypes structures of the CUDA kernels' arguments (kernels/frame.h, kernels/loss.cu)."""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING

from ..kernels.bindings import AdamParameter, Camera, Gaussians, Gradients, Outputs

if TYPE_CHECKING:
    from torch import Tensor

PIXELS = 256  # pixels of a tile, and threads of a block that blends it
GROUP = 128  # entries of a tile's list that a block processes together
BUCKETS = 4  # buckets of a group
COLUMNS = 16  # columns of a splat
MOMENTS, PLANE_MOMENTS = 9, 6  # moments of a slot
PLANE_COLUMNS = 8  # columns of a splat's plane
ROWS = 128  # Gaussians of a block
WARP = 32
CAMERA_VALUES = 22  # floats of a camera that kernels read
SHORT_TILES = 1 << 15  # with fewer tiles, tile numbers and the number for "no tile" fit 16 bits

_ADDRESS = ctypes.c_void_p


class Frame(ctypes.Structure):
    """frame.h: struct Frame."""

    _fields_ = [
        ("gaussians", Gaussians),
        ("shape", Camera),
        *(
            (name, _ADDRESS)
            for name in (
                *(
                    "pose",
                    "intrinsics",
                    "background",
                    "camera_values",
                    "splats",
                    "planes",
                    "depths",
                ),
                *("pair_counts", "first_slot", "visible", "order", "ends", "void"),
                *(
                    "short_tiles",
                    "tiles",
                    "ids",
                    "moments",
                    "plane_moments",
                    "slot_largest",
                    "slot_sums",
                ),
            )
        ),
        ("pairs", ctypes.c_int64),
        *(
            (name, _ADDRESS)
            for name in (
                *("short_sorted", "sorted", "entries", "tile_begin", "group_begin", "reached"),
                *("checkpoints", "surface_checkpoints"),
            )
        ),
        ("out", Outputs),
        ("median", _ADDRESS),
        ("image_gradient", _ADDRESS),
        ("surface_gradient", _ADDRESS),
        ("gradients", Gradients),
        ("grad2d", _ADDRESS),
        ("tile_count", ctypes.c_int32),
    ]


class Step(ctypes.Structure):
    """frame.h: struct Step."""

    _fields_ = [
        ("frame", Frame),
        ("parameters", AdamParameter * 5),
        *(
            (name, ctypes.c_float)
            for name in ("add1", "add2", "epsilon", "inverse_sqrt_correction2", "rate_scale")
        ),
        ("skipped", _ADDRESS),
        ("row_rates", _ADDRESS),
    ]


class Loss(ctypes.Structure):
    """loss.cu: struct Loss."""

    _fields_ = [
        ("width", ctypes.c_int64),
        ("height", ctypes.c_int64),
        *((name, _ADDRESS) for name in ("image", "target", "weights", "total")),
        ("ssim_weight", ctypes.c_float),
        *((name, _ADDRESS) for name in ("derivatives", "sums", "gradient", "terms")),
        ("blocks", ctypes.c_int64),
    ]


def address(tensor: Tensor | None) -> int | None:
    """The address of a tensor's first element on its device; null for None.

    The caller must check shape, type and strides, and keep the tensor alive until the kernel ends.
    """
    return None if tensor is None else tensor.data_ptr()
