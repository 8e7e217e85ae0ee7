"""ICC profiles of primaries and curves: made of the numbers that files name, and read as such."""

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
"""x and y of red, green, blue and white."""

D65 = (0.3127, 0.3290)
SRGB: Primaries = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, *D65)
ADOBE_RGB: Primaries = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *D65)
ADOBE_GAMMA = 563 / 256
# Code points of ITU-T H.273, tables 2 and 3; others have sRGB's primaries or curve. So have the
# camera curves of BT.709 and BT.2020 (1, 6, 14, 15), which screens show as they show sRGB.
CICP_PRIMARIES: dict[int, Primaries] = {
    4: (0.67, 0.33, 0.21, 0.71, 0.14, 0.08, 0.310, 0.316),
    5: (0.64, 0.33, 0.29, 0.60, 0.15, 0.06, *D65),
    6: (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *D65),
    7: (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *D65),
    9: (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *D65),
    11: (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.314, 0.351),
    12: (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *D65),
    22: (0.630, 0.340, 0.295, 0.605, 0.155, 0.077, *D65),
}
REFERENCE_WHITE = 203.0  # cd/m2 of PQ and HLG that become white: ITU-R BT.2408
HLG_PEAK = 1000.0  # cd/m2 of the screen that HLG is meant for: ITU-R BT.2100
PART = 1 << 18  # pixels that are converted at once
SAMPLES = 255 * 16 + 1  # of a curve: the values of 8 bits are among them
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


def power_curve(exponent: float) -> Curve:
    """Values to a power."""
    return lambda values: np.asarray(values**exponent)


def pq_light(values: Values) -> Values:
    """cd/m2 of a PQ signal (SMPTE ST 2084)."""
    m1, m2, c1, c2, c3 = 0.1593017578125, 78.84375, 0.8359375, 18.8515625, 18.6875
    root = values ** (1 / m2)
    return np.asarray(10_000 * (np.maximum(root - c1, 0) / (c2 - c3 * root)) ** (1 / m1))


def hlg_scene(values: Values) -> Values:
    """Light of the scene of an HLG signal (ITU-R BT.2100, table 5), 0 to 1."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    return np.where(values <= 0.5, values**2 / 3, (np.exp((values - c) / a) + b) / 12)


def pq_curve(values: Values) -> Values:
    """Light of a PQ signal; what is brighter than the reference white becomes white."""
    return np.asarray(np.minimum(pq_light(values) / REFERENCE_WHITE, 1))


def hlg_curve(values: Values) -> Values:
    """Light of an HLG signal on a screen, of gamma 1.2 for each channel; white as in `pq_curve`."""
    return np.minimum(HLG_PEAK * hlg_scene(values) ** 1.2 / REFERENCE_WHITE, 1)


CICP_CURVES: dict[int, Curve] = {
    4: power_curve(2.2),
    5: power_curve(2.8),
    8: power_curve(1.0),
    16: pq_curve,
    18: hlg_curve,
}


@lru_cache(maxsize=16)
def cicp_profile(primaries: int, transfer: int, *, limited: bool = False) -> bytes:
    """The profile of two code points of ITU-T H.273; empty: sRGB.

    `limited`: black is 16 of 255, white 235 (H.273, 8.3), which the curves then undo.
    """
    if primaries not in CICP_PRIMARIES and transfer not in CICP_CURVES and not limited:
        return b""
    curve = CICP_CURVES.get(transfer, srgb_curve)
    used = (lambda v: curve(np.clip((255 * v - 16) / 219, 0, 1))) if limited else curve
    return profile(CICP_PRIMARIES.get(primaries, SRGB), used)


@lru_cache(maxsize=16)
def gamma_profile(primaries: Primaries, exponent: float | None) -> bytes:
    """The profile with that power, or with sRGB's curve; ValueError: no such space."""
    return profile(primaries, srgb_curve if exponent is None else power_curve(exponent))


def profile(primaries: Primaries, curve: Curve) -> bytes:
    """An ICC profile (version 2, matrix and curves); ValueError: the primaries span no space."""
    with np.errstate(all="ignore"):
        matrix = _to_d50(primaries)
        table = np.clip(curve(np.linspace(0, 1, SAMPLES)) * 65535, 0, 65535).round()
    if not np.isfinite(matrix).all() or np.abs(matrix).max() > 100 or np.isnan(table).any():
        raise ValueError("primaries that span no colour space")
    curves = struct.pack(">4s4xI", b"curv", SAMPLES) + table.astype(">u2").tobytes()
    columns = dict(zip((b"rXYZ", b"gXYZ", b"bXYZ"), map(_xyz, matrix.T), strict=True))
    parts = {
        b"desc": struct.pack(">4s4xI6s", b"desc", 6, b"space\0").ljust(96, b"\0"),
        b"cprt": struct.pack(">4s4x4s", b"text", b"CC0\0"),
        b"wtpt": _xyz(D50),
        **columns,
        **dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curves),
    }
    table_size = 4 + 12 * len(parts)
    places, body = {}, b""
    for data in dict.fromkeys(parts.values()):
        places[data] = 128 + table_size + len(body)
        body += data + b"\0" * (-len(data) % 4)
    tags = b"".join(struct.pack(">4sII", t, places[d], len(d)) for t, d in parts.items())
    size = 128 + table_size + len(body)
    head = struct.pack(">I4xI4s4s4s", size, 0x02400000, b"mntr", b"RGB ", b"XYZ ")
    head = (head + struct.pack(">12x4s28x", b"acsp") + _xyz(D50)[8:]).ljust(128, b"\0")
    return head + struct.pack(">I", len(parts)) + tags + body


def parts_of(pixels: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Views of rows of (H, W, ...), of at most `PART` pixels each, but one row at least."""
    rows = max(1, PART // max(1, pixels.shape[1]))
    return (pixels[top : top + rows] for top in range(0, len(pixels), rows))


@dataclass(frozen=True)
class Space:
    """A colour space of curves and a matrix, with which values of 16 bits are converted.

    `curves`: for each channel, (65536,) float32 linear light of all values. `matrix`: (3, 3),
    linear light of the channels -> that of sRGB; None: the only channel is grey.
    """

    curves: tuple[NDArray[np.float32], ...]
    matrix: NDArray[np.float32] | None

    def to_srgb(self, values: Deep) -> NDArray[np.uint8]:
        """(H, W, 3) sRGB of (H, W, 1 or 3) values, rounded; what lies outside is clipped.

        The result takes the place of values in RGB, which are lost: photos may be large.
        """
        encoded = _encoded()
        if values.shape[2] == 3 and values.flags.c_contiguous:
            result = values.reshape(-1).view(np.uint8)[: values.size].reshape(values.shape)
        else:
            result = np.empty((*values.shape[:2], 3), np.uint8)
        # Else ten times the memory of the photo.
        for part, made in zip(parts_of(values), parts_of(result), strict=True):
            channels = range(len(self.curves))
            light = np.stack([self.curves[k][part[..., min(k, part.shape[2] - 1)]]
                              for k in channels], axis=-1)  # fmt: skip
            if self.matrix is not None:
                light = light @ self.matrix.T
            made[:] = encoded[(light.clip(0, 1) * 65535 + 0.5).astype(np.uint16)]
        return result


@lru_cache(maxsize=1)
def _encoded() -> NDArray[np.uint8]:
    """(65536,) linear light -> sRGB (IEC 61966-2-1)."""
    return (255 * srgb_values(np.linspace(0, 1, 65536))).round().astype(np.uint8)


@lru_cache(maxsize=8)
def space_of(icc: bytes) -> Space | None:
    """The space of a profile that LittleCMS reads; None: it has tables instead (ICC.1, 8.3).

    On tags that are damaged: struct.error, ValueError, IndexError or ArithmeticError.
    """
    (count,) = struct.unpack_from(">I", icc, 128)
    entries = [struct.unpack_from(">4sII", icc, 132 + 12 * k) for k in range(count)]
    tags = {name: icc[start : start + size] for name, start, size in entries}
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
        matrix = (np.linalg.inv(_to_d50(SRGB)) @ to_xyz).astype(np.float32)
    compensated = [(curve - black) / (1 - black) for curve in curves]  # for the black point
    if not np.isfinite(compensated).all():
        return None
    return Space(tuple(curve.astype(np.float32) for curve in compensated), matrix)


def _curve(tag: bytes) -> Values:
    """(65536,) linear light of a tag: curveType or parametricCurveType (ICC.1, 10.6 and 10.18)."""
    values = np.linspace(0, 1, 65536)
    if tag[:4] == b"curv":
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
    if kind < 3:  # c is added to both parts
        d, e, f, c = -b / a, c, c, 0.0
    power = np.maximum(a * values + b, 0) ** g + e
    return np.asarray(np.where(values >= d, power, c * values + f).clip(0, 1))


def _to_d50(primaries: Primaries) -> Values:
    """(3, 3): linear RGB -> XYZ whose white is D50."""
    x, y = np.array(primaries).reshape(4, 2).T
    xyz = np.stack([x / y, np.ones(4), (1 - x - y) / y])
    white = xyz[:, 3]
    try:
        matrix = xyz[:, :3] * np.linalg.solve(xyz[:, :3], white)
    except np.linalg.LinAlgError as error:
        raise ValueError("primaries that span no colour space") from error
    ratios = np.diag((BRADFORD @ D50) / (BRADFORD @ white))
    return np.asarray(np.linalg.inv(BRADFORD) @ ratios @ BRADFORD @ matrix)


def _xyz(values: Values) -> bytes:
    """An XYZ tag: numbers of 16 bits before and 16 behind the point."""
    return struct.pack(">4s4x3i", b"XYZ ", *(round(float(value) * 65536) for value in values))
