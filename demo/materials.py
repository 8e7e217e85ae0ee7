# SPDX-License-Identifier: GPL-3.0-or-later
"""The materials that several pieces of the demo room share."""

from __future__ import annotations

import textures as tx
from build import image, image_material, plain_material

OAK = ((0.38, 0.24, 0.14), (0.50, 0.33, 0.20), (0.60, 0.43, 0.27))
WALNUT = ((0.20, 0.12, 0.08), (0.29, 0.18, 0.12), (0.38, 0.25, 0.16))
PINE = ((0.60, 0.43, 0.25), (0.70, 0.53, 0.33), (0.78, 0.62, 0.42))


class Library:
    """The materials that several pieces of furniture share."""

    def __init__(self) -> None:
        self.oak = image("oak", tx.wood(1536, 1024, 11, OAK, 8.0))
        self.walnut = image("walnut", tx.wood(1536, 1024, 12, WALNUT, 10.0))
        self.pine = image("pine", tx.wood(1024, 1024, 13, PINE, 7.0))
        self.table = image_material("table oak", self.oak, (1.7, 0.95), 0.0006)
        self.dark = image_material("walnut", self.walnut, (1.3, 0.6), 0.0006)
        self.light = image_material("pine", self.pine, (1.2, 0.7), 0.0006)
        paint = tx.plaster(1024, 1024, 14, (0.93, 0.91, 0.86), (0.80, 0.77, 0.70))
        self.paint = image_material("white paint", image("paint", paint), (1.0, 1.0), 0.001)
        self.brass = plain_material("brass", (0.67, 0.50, 0.22))
        self.ink = plain_material("ink", (0.09, 0.08, 0.08))
        self.gold = plain_material("gold lettering", (0.86, 0.72, 0.38))
