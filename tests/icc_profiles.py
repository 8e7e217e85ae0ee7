"""ICC profiles of primaries and curves, for photos of tests."""

from __future__ import annotations

import struct

import numpy as np

from roigs_engine.photos.profiles import (
    ADOBE_GAMMA,
    ADOBE_RGB,
    D50,
    PRIMARIES,
    SRGB,
    Curve,
    Primaries,
    Values,
    srgb_curve,
    to_d50,
)

SAMPLES = 255 * 16 + 1  # of a curve: the values of 8 bits are among them


def power_curve(exponent: float) -> Curve:
    """Values to a power."""
    return lambda values: np.asarray(values**exponent)


def profile(primaries: Primaries, curve: Curve) -> bytes:
    """An ICC profile (version 2, matrix and curves)."""
    matrix = to_d50(primaries)
    table = np.clip(curve(np.linspace(0, 1, SAMPLES)) * 65535, 0, 65535).round()
    curves = struct.pack(">4s4xI", b"curv", SAMPLES) + table.astype(">u2").tobytes()
    columns = dict(zip((b"rXYZ", b"gXYZ", b"bXYZ"), map(xyz_tag, matrix.T), strict=True))
    parts = {
        b"desc": struct.pack(">4s4xI6s", b"desc", 6, b"space\0").ljust(96, b"\0"),
        b"cprt": struct.pack(">4s4x4s", b"text", b"CC0\0"),
        b"wtpt": xyz_tag(D50),
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
    head = (head + struct.pack(">12x4s28x", b"acsp") + xyz_tag(D50)[8:]).ljust(128, b"\0")
    return head + struct.pack(">I", len(parts)) + tags + body


def xyz_tag(values: Values) -> bytes:
    """An XYZ tag: numbers of 16 bits before and 16 behind the point."""
    return struct.pack(">4s4x3i", b"XYZ ", *(round(float(value) * 65536) for value in values))


P3 = PRIMARIES[12][1]
P3_PROFILE = profile(P3, srgb_curve)
ADOBE_PROFILE = profile(ADOBE_RGB, power_curve(ADOBE_GAMMA))
LINEAR_PROFILE = profile(SRGB, power_curve(1.0))
