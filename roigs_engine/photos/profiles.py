"""Colour spaces from primaries and curves, given by numbers in files or by ICC profiles."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
Deep = NDArray[np.uint16]
"""(H, W, channels) encoded values, 65,535 for white."""
Curve = Callable[[Values], Values]
"""Encoded values, 0 to 1 -> linear light, 1 for white."""
Primaries = tuple[float, float, float, float, float, float, float, float]
"""Chromaticities x and y of red, green, blue and white."""

D65 = (0.3127, 0.3290)
SRGB: Primaries = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, *D65)
ADOBE_RGB: Primaries = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *D65)
ADOBE_GAMMA = 563 / 256
PRIMARIES: dict[int, tuple[str, Primaries]] = {  # ITU-T H.273, table 2
    1: ("BT.709", SRGB),
    4: ("BT.470 M", (0.67, 0.33, 0.21, 0.71, 0.14, 0.08, 0.310, 0.316)),
    5: ("BT.601 (625 lines)", (0.64, 0.33, 0.29, 0.60, 0.15, 0.06, *D65)),
    6: ("BT.601 (525 lines)", (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *D65)),
    7: ("SMPTE 240M", (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *D65)),
    8: ("film", (0.681, 0.319, 0.243, 0.692, 0.145, 0.049, 0.310, 0.316)),
    9: ("BT.2020", (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *D65)),
    10: ("XYZ", (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)),
    11: ("DCI-P3", (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.314, 0.351)),
    12: ("Display P3", (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *D65)),
    22: ("EBU Tech. 3213", (0.630, 0.340, 0.295, 0.605, 0.155, 0.077, *D65)),
}
PQ, HLG = 16, 18
REFERENCE_WHITE = 203.0  # cd/m2 in PQ and HLG that become white (ITU-R BT.2408)
HLG_PEAK = 1000.0  # cd/m2 of HLG's reference screen (ITU-R BT.2100)
PART = 1 << 18  # pixels converted at once
WHITE = 65535
# CIE XYZ of ICC's white, and Bradford's matrix, which adapts other whites to it (ICC.1, annex E).
D50 = np.array([0.9642, 1.0, 0.8249])
BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


def srgb_curve(values: Values) -> Values:
    """IEC 61966-2-1."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def srgb_values(light: Values) -> Values:
    """The inverse of `srgb_curve`, for light of 0 or more."""
    curve = 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(light <= 0.0031308, 12.92 * light, curve)


def pq_light(values: Values) -> Values:
    """cd/m2 of a PQ signal (SMPTE ST 2084)."""
    m1, m2, c1, c2, c3 = 0.1593017578125, 78.84375, 0.8359375, 18.8515625, 18.6875
    root = values ** (1 / m2)
    return np.asarray(10_000 * (np.maximum(root - c1, 0) / (c2 - c3 * root)) ** (1 / m1))


def hlg_scene(values: Values) -> Values:
    """Light of the scene of an HLG signal (ITU-R BT.2100, table 5), 0 to 1."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    return np.where(values <= 0.5, values**2 / 3, (np.exp((values - c) / a) + b) / 12)


def hlg_screen(values: Values) -> Values:
    """Light of an HLG signal on a screen, of gamma 1.2 for each channel."""
    return np.asarray(HLG_PEAK * hlg_scene(values) ** 1.2 / REFERENCE_WHITE)


LIKE_SRGB = (1, 6, 7, 11, 12, 13, 14, 15)
"""Curves of cameras that are close to BT.709's. Browsers, players and editors show such signals
unchanged on sRGB screens, so they count as sRGB."""
CURVES: dict[int, tuple[str, Curve]] = {  # H.273, table 3
    **dict.fromkeys(LIKE_SRGB, ("", srgb_curve)),
    4: ("gamma 2.2", lambda v: v**2.2),
    5: ("gamma 2.8", lambda v: v**2.8),
    8: ("linear", lambda v: v),
    9: ("logarithmic", lambda v: np.where(v > 0, 10 ** (2 * (v - 1)), 0)),
    10: ("logarithmic", lambda v: np.where(v > 0, 10 ** (2.5 * (v - 1)), 0)),
    PQ: ("PQ", lambda v: pq_light(v) / REFERENCE_WHITE),
    17: ("SMPTE ST 428", lambda v: 52.37 / 48 * v**2.6),
    HLG: ("HLG", hlg_scene),
}


def parts_of(pixels: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Split (H, W, ...) into views of whole rows, of at most `PART` pixels or one row each."""
    rows = max(1, PART // max(1, pixels.shape[1]))
    return (pixels[top : top + rows] for top in range(0, len(pixels), rows))


@dataclass(frozen=True, eq=False)
class Space:
    """A colour space defined by curves and a matrix.

    `curves`: for each channel, (65536,) float32 linear light of all values. `matrix`: (3, 3),
    linear light of the channels -> linear sRGB; None: the only channel is grey.
    """

    curves: tuple[NDArray[np.float32], ...]
    matrix: NDArray[np.float32] | None

    def light(self, values: NDArray[np.unsignedinteger[Any]]) -> NDArray[np.float32]:
        """Values (H, W, 1 or 3) of 8 or 16 bits -> linear sRGB light (H, W, 1 or 3)."""
        step = 1 if values.dtype == np.uint16 else 257
        channels = [values[..., min(k, values.shape[2] - 1)] for k in range(len(self.curves))]
        found = [curve[::step][each] for curve, each in zip(self.curves, channels, strict=True)]
        light = np.stack(found, axis=-1)
        return light if self.matrix is None else np.asarray(light @ self.matrix.T)

    def to_srgb(self, values: NDArray[np.unsignedinteger[Any]]) -> NDArray[np.uint8]:
        """Values as for `light` -> (H, W, 3) sRGB, rounded and clipped.

        The result overwrites RGB values in their memory, because photos may be large.
        """
        if values.shape[2] == 3 and values.flags.c_contiguous:
            result = values.reshape(-1).view(np.uint8)[: values.size].reshape(values.shape)
        else:
            result = np.empty((*values.shape[:2], 3), np.uint8)
        # In parts: at once, this would take ten times the memory of the photo.
        for part, made in zip(parts_of(values), parts_of(result), strict=True):
            made[:] = encoded(self.light(part))
        return result


def encoded(light: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Linear light -> sRGB (IEC 61966-2-1), rounded; light outside 0 to 1 is clipped."""
    return _encoded()[(light.clip(0, 1) * WHITE + 0.5).astype(np.uint16)]


@lru_cache(maxsize=1)
def _encoded() -> NDArray[np.uint8]:
    return (255 * srgb_values(np.linspace(0, 1, WHITE + 1))).round().astype(np.uint8)


def space_of(primaries: Primaries, curve: Curve, *, limited: bool = False) -> Space:
    """The space of primaries and a curve; ValueError: the primaries span no space.

    `limited`: black is 16 of 255, white 235 (H.273, 8.3).
    """
    values = np.linspace(0, 1, WHITE + 1)
    if limited:
        values = ((255 * values - 16) / 219).clip(0, 1)
    with np.errstate(all="ignore"):
        matrix = np.linalg.inv(to_d50(SRGB)) @ to_d50(primaries)
    if not np.abs(matrix).max() < 100:  # refuses NaN, too
        raise ValueError("primaries that span no colour space")
    return Space((curve(values).astype(np.float32),) * 3, matrix.astype(np.float32))


@lru_cache(maxsize=16)
def space_of_code(primaries: int, transfer: int, *, limited: bool = False) -> Space:
    """The space of a photo's two code points of ITU-T H.273; unknown ones count as sRGB's.

    Colours brighter than the reference white become white.
    """
    curve = hlg_screen if transfer == HLG else CURVES.get(transfer, CURVES[1])[1]
    known = PRIMARIES.get(primaries, PRIMARIES[1])[1]
    return space_of(known, lambda values: np.minimum(curve(values), 1), limited=limited)


@lru_cache(maxsize=16)
def space_of_gamma(primaries: Primaries, exponent: float | None) -> Space:
    """The space with that power, or with sRGB's curve; ValueError: no such space."""
    return space_of(primaries, srgb_curve if exponent is None else lambda v: v**exponent)


@lru_cache(maxsize=8)
def space_of_profile(icc: bytes) -> Space | None:
    """The space of an ICC profile that LittleCMS accepts; None: it has tables (ICC.1, 8.3).

    Damaged tags raise struct.error, ValueError, IndexError or ArithmeticError.
    """
    (count,) = struct.unpack_from(">I", icc, 128)
    entries = [struct.unpack_from(">4sII", icc, 132 + 12 * k) for k in range(count)]
    whole = memoryview(icc)  # without copies: many tags may share the same data
    tags = {name: whole[start : start + size] for name, start, size in entries}
    if icc[20:24] != b"XYZ " or any(name[:3] in (b"A2B", b"D2B") for name in tags):
        return None
    names = (b"k",) if icc[16:20] == b"GRAY" else (b"r", b"g", b"b")
    if not all(name + b"TRC" in tags for name in names):
        return None
    curves = [_curve(tags[name + b"TRC"]) for name in names]
    matrix = None
    black = curves[0][0]
    if len(names) == 3:
        xyz = [struct.unpack_from(">3i", tags[name + b"XYZ"], 8) for name in names]
        to_xyz = np.array(xyz, dtype=np.float64).T / 65536
        black = (to_xyz @ [curve[0] for curve in curves])[1]
        matrix = (np.linalg.inv(to_d50(SRGB)) @ to_xyz).astype(np.float32)
    compensated = [(curve - black) / (1 - black) for curve in curves]  # black point compensation
    if not np.isfinite(compensated).all():
        return None
    return Space(tuple(curve.astype(np.float32) for curve in compensated), matrix)


def _curve(tag: memoryview) -> Values:
    """(65536,) linear light from a curveType or parametricCurveType tag (ICC.1, 10.6, 10.18)."""
    values = np.linspace(0, 1, 65536)
    if bytes(tag[:4]) == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        table = np.frombuffer(tag, ">u2", count, 12)
        if count <= 1:
            return values ** (table[0] / 256) if count else values
        return np.interp(values, np.linspace(0, 1, count), table / 65535)
    kind = struct.unpack_from(">H", tag, 8)[0]
    numbers = np.frombuffer(tag, ">i4", (1, 3, 4, 5, 7)[kind], 12) / 65536
    g, a, b, c, d, e, f = [*map(float, numbers), *[0.0] * (7 - len(numbers))]
    if kind == 0:
        return np.asarray(values**g)
    if kind < 3:  # these add c in both parts of the curve
        d, e, f, c = -b / a, c, c, 0.0
    power = np.maximum(a * values + b, 0) ** g + e
    return np.asarray(np.where(values >= d, power, c * values + f).clip(0, 1))


def to_d50(primaries: Primaries) -> Values:
    """(3, 3): linear RGB -> XYZ whose white is D50; ValueError: they span no space."""
    places = np.array(primaries).reshape(4, 2)
    xyz = np.column_stack([places, 1 - places.sum(axis=1)]).T
    white = xyz[:, 3] / xyz[1, 3]
    try:
        matrix = xyz[:, :3] * np.linalg.solve(xyz[:, :3], white)
    except np.linalg.LinAlgError as error:
        raise ValueError("primaries that span no colour space") from error
    ratios = np.diag((BRADFORD @ D50) / (BRADFORD @ white))
    return np.asarray(np.linalg.inv(BRADFORD) @ ratios @ BRADFORD @ matrix)
