"""Checks of numbers in files: shapes, rigid transforms of boxes and cameras, similarities."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

SCALES = (1e-9, 1e9)  # valid scales of a similarity; others come from damaged files
UNEVEN = "it scales or shears"
TOLERANCE = 1e-4  # for products of axes; accepts matrices written with five digits


def numbers(
    value: Any, shape: tuple[int | None, ...], name: str, most: float = math.inf
) -> NDArray[np.float64]:
    """Convert a JSON value to an array of this shape, with absolute values below `most`.

    None in `shape` stands for any length but 0.

    Raises:
        ValueError: the shape or a number is wrong; the message begins with `name`.
        OverflowError: an integer is too large.
    """
    array = np.array(value, dtype=object)
    sizes = zip(array.shape, shape, strict=False)
    fits = array.ndim == len(shape) and all(n == wanted if wanted else n for n, wanted in sizes)
    if not fits or not all(type(number) in (int, float) for number in array.flat):
        raise ValueError(f"{name} must be {' x '.join(str(n or 'N') for n in shape)} numbers")
    found = array.astype(np.float64)
    if not (np.abs(found) < most).all():  # catches NaN too
        raise ValueError(f"{name} has a number that is NaN, Inf or too large")
    return found


def is_mirrored(matrix: NDArray[np.float64]) -> bool:
    """Whether a (4, 4) matrix with orthogonal axes mirrors space."""
    return float(np.linalg.det(matrix[:3, :3])) < 0


def rigid_flaw(matrix: NDArray[np.float64]) -> str:
    """The reason why a (4, 4) matrix is not a rotation and a translation; empty if it is one."""
    if not np.allclose(matrix[3], (0, 0, 0, 1), rtol=0, atol=1e-6):
        row = ", ".join(f"{number:g}" for number in matrix[3])
        return f"its last row is {row}, not 0, 0, 0, 1 (is it transposed?)"
    rotation = matrix[:3, :3]
    with np.errstate(all="ignore"):
        products = rotation @ rotation.T
    if not np.allclose(products, np.eye(3), rtol=0, atol=TOLERANCE):
        return UNEVEN
    return "it mirrors" if is_mirrored(matrix) else ""


def similarity_flaw(matrix: NDArray[np.float64]) -> str:
    """The reason why a (4, 4) matrix is not a similarity; empty if it is one."""
    scale = scale_of(matrix)
    if not SCALES[0] <= scale <= SCALES[1]:
        return f"its scale is {scale:g}"
    rigid = matrix.copy()
    rigid[:3, :3] /= scale
    flaw = rigid_flaw(rigid)
    return "it scales the axes unevenly, or shears" if flaw == UNEVEN else flaw


def scale_of(matrix: NDArray[np.float64]) -> float:
    """The scale of a (4, 4) similarity; in general, the cube root of the change in volume."""
    with np.errstate(all="ignore"):
        return float(np.cbrt(np.abs(np.linalg.det(matrix[:3, :3]))))
