"""Bytes that each stage of a training step reads and writes, counted from the kernels' sources.

What is counted is data that a stage uses, once per use: neither the rest of a cache line nor what a
write fetches first. The caches hold a part of it, so memory moves less.
"""

from __future__ import annotations

from dataclasses import dataclass

PARAMETERS = 4 * (3 + 4 + 3 + 1 + 48)  # means, quats, scales, opacity, sh of degree 3; float32
SHAPE = 4 * (3 + 4 + 3 + 1)  # without colours
HARMONICS = 4 * 48
SPLAT = SLOT = 64  # view.h: Splat, SlotGradient
SPAN = ENTRY = KEY = 8  # view.h: TileSpan, TileEntry; a depth and a row number
INDEX = 4
# view.h: BlockSet, in seen_in and in passed_in
BLOCKS = {"avx512": 2 * 2, "avx2": 2 * 4, "generic": 2 * 8, "neon": 2 * 8}
PASSES = 3  # of the radix sort


@dataclass(frozen=True)
class View:
    """What a step has to do.

    Attributes:
        gaussians: of the model.
        visible: of them, in the picture.
        intersections: of visible Gaussians and tiles.
        pixels: of the picture.
        updated: the share of the visible that pixels give a gradient.
    """

    gaussians: float
    visible: float
    intersections: float
    pixels: float
    updated: float = 1.0


def stage_bytes(view: View, isa: str = "avx512") -> dict[str, tuple[float, float]]:
    """Stage -> bytes read and bytes written."""
    n, v, i, px = view.gaussians, view.visible, view.intersections, view.pixels
    blocks = BLOCKS[isa]
    deal = 2 * (v * (INDEX + SPAN) + i * INDEX)  # counts, then lists
    return {
        "project": (n * SHAPE + v * HARMONICS, v * (SPLAT + SPAN + 1) + i * INDEX),
        "bin": (
            v * SPLAT + PASSES * v * (INDEX + KEY) + deal,  # a pass counts, then moves
            (1 + PASSES) * v * KEY + i * ENTRY,
        ),
        "raster": (i * (ENTRY + SPLAT), i * blocks + 16 * px),
        "loss": (px * (12 + 3), 12 * px),
        "raster backward": (i * (ENTRY + blocks + SPLAT) + 24 * px, i * SLOT),
        "update": (
            v * SPLAT + view.updated * (v * (SPAN + 3 * PARAMETERS) + i * SLOT),
            view.updated * v * (3 * PARAMETERS + 4),
        ),
    }
