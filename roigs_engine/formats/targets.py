"""Targets: renderers that a model can be made for, and how they draw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

BLUR = 0.3
"""Blur of 3DGS, px^2: each Gaussian covers at least about a pixel."""
BOX = 1 / 12
"""Blur that equals averaging over a square pixel, px^2: the pixel's variance."""


@dataclass(frozen=True, kw_only=True)
class Target:
    """A kind of renderer: a model looks right only where it is drawn as it was trained.

    Attributes:
        name: in options and files.
        title: for users.
        help: one line: which renderers these are.
        antialiased: a Gaussian below a pixel's size is fainter, not larger (Mip-Splatting, Yu et
            al. 2024, sec. 5.2); False: 3DGS.
        linear_light: each Gaussian's colour becomes linear light, and light is blended; False: sRGB
            values are blended (3DGS).
        blur: added to the diagonal of a Gaussian's covariance in the picture, px^2.
    """

    name: str
    title: str
    help: str
    antialiased: bool
    linear_light: bool
    blur: float = BLUR

    @property
    def drawing(self) -> dict[str, Any]:
        """The arguments for `rasterize`."""
        return {
            "antialiased": self.antialiased,
            "linear_light": self.linear_light,
            "blur": self.blur,
        }


VIEWERS = Target(
    name="viewers",
    title="Splat Viewers",
    help="This add-on's view, web pages, viewers with anti-aliasing: sharp from near and far",
    antialiased=True,
    linear_light=False,
)
PLAIN = Target(
    name="plain",
    title="Viewers without Anti-Aliasing",
    help="Viewers that draw like 3DGS, and formats such as glTF, USD and .splat",
    antialiased=False,
    linear_light=False,
)
# Blender 5.3, intern/cycles/kernel/geom/gsplat.h. Cycles averages over the pixel. A larger and
# fainter Gaussian has the same effect.
CYCLES = Target(
    name="cycles",
    title="Blender 5.3, Cycles",
    help="Blender's own splats in Cycles, which blends linear light",
    antialiased=True,
    linear_light=True,
    blur=BOX,
)
# From the source of Blender 5.3, draw_gsplat_lib.bsl.hh; not compared with renders.
EEVEE = Target(
    name="eevee",
    title="Blender 5.3, EEVEE",
    help="Blender's own splats in EEVEE, which blends linear light, without anti-aliasing",
    antialiased=False,
    linear_light=True,
)
TARGETS = {target.name: target for target in (VIEWERS, PLAIN, CYCLES, EEVEE)}


def target_with(*, antialiased: bool, linear_light: bool = False) -> Target:
    """The target with these settings."""
    wanted = antialiased, linear_light
    return next(t for t in TARGETS.values() if (t.antialiased, t.linear_light) == wanted)
