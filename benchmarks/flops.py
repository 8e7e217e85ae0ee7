"""Floating-point operations: what a pair evaluation needs, and how many one core can do.

Counted is the arithmetic in the sources for one Gaussian at one pixel: additions, subtractions and
multiplications as 1, a fused multiply-add as 2. Comparisons, masks, minima, roundings, exponent
edits, the estimate that `reciprocal` starts from, and all work per Gaussian or tile (culling of
blocks, sums over lanes) count as nothing, so the share of the peak is that of useful arithmetic.
"""

from __future__ import annotations

import ctypes
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from roigs_engine.kernels import build

EXPONENT = 10  # Together, tile.h: u 2 FMA, v 1, the two squares 2
EXP2 = 11  # exp2, simd.h: x - round(x), and 5 FMA
WEIGHT = 2  # weight = alpha T, T -= weight
FORWARD = EXPONENT + EXP2 + WEIGHT + 6  # blend_block, raster_forward.cpp: 3 colours, an FMA each

DIFFERENTIATE = (
    EXPONENT
    + EXP2
    + WEIGHT
    + 5  # colour . v: a product, 2 FMA
    + 2  # R -= weight (colour . v)
    + 4  # 1 - alpha; its reciprocal: an FMA and a product
    + 3  # dL / d(alpha): a product, an FMA
    + 1  # s = alpha dL / d(alpha)
)
ACCUMULATE = 2 + 3 + 6 + 6  # s u and s v; three sums; 3 FMA for second moments, 3 for colours
BACKWARD = DIFFERENTIATE + ACCUMULATE  # raster_backward.cpp

PER_PAIR = {"raster": FORWARD, "raster backward": BACKWARD}
"""Stage -> operations per pair evaluation."""

SOURCE = Path(__file__).with_name("peak.cpp")
STEPS, REPEATS = 500_000, 5  # a few milliseconds in all


@contextmanager
def peak_libraries() -> Iterator[dict[str, Path]]:
    """Compile peak.cpp; yields instruction set -> library, which exist within the context."""
    with tempfile.TemporaryDirectory(prefix="roigs-peak-") as folder:
        yield build.compile_all([SOURCE], Path(folder), build.native_platform())


def peak_gflops(library: Path) -> float:
    """Peak GFLOP/s of one core in fused multiply-adds: best of several short runs, by CPU time."""
    chains = ctypes.CDLL(str(library)).roigs_fma_chains
    chains.argtypes, chains.restype = [ctypes.c_int64, ctypes.c_void_p], ctypes.c_double
    result = ctypes.c_float()
    best = 0.0
    for _ in range(REPEATS):
        start = time.thread_time()
        operations = chains(STEPS, ctypes.byref(result))
        best = max(best, 1e-9 * operations / (time.thread_time() - start))
    return best
