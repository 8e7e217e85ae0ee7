"""Colours of a video as sRGB, by the tags of its stream (ITU-T H.273, H.264's and HEVC's VUI).

libswscale undoes range and matrix. Primaries and transfer follow here. HDR is tone-mapped with one
curve for all frames: photogrammetry needs the same colour for the same point in each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..photos.profiles import (
    BRADFORD,
    CICP_PRIMARIES,
    D65,
    HLG_PEAK,
    REFERENCE_WHITE,
    SRGB,
    Primaries,
    hlg_scene,
    pq_light,
    srgb_curve,
    srgb_values,
)

Pixels = NDArray[np.uint8]
Light = NDArray[np.float64]

UNKNOWN = (0, 2, 3)  # reserved or unspecified
WHITE_C = (0.310, 0.316)
NAMES = {  # of primaries: H.273, table 2
    1: "BT.709",
    4: "BT.470 M",
    5: "BT.601 (625 lines)",
    6: "BT.601 (525 lines)",
    7: "SMPTE 240M",
    8: "film",
    9: "BT.2020",
    10: "XYZ",
    11: "DCI-P3",
    12: "Display P3",
    22: "EBU Tech. 3213",
}
PRIMARIES: dict[int, Primaries] = {
    **CICP_PRIMARIES,
    1: SRGB,
    8: (0.681, 0.319, 0.243, 0.692, 0.145, 0.049, *WHITE_C),
    10: (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3),
}
MATRICES = {1: "BT.709", 4: "FCC", 5: "BT.601", 6: "BT.601", 7: "SMPTE 240M", 9: "BT.2020"}
DERIVED = {1: 1, 5: 5, 6: 6, 9: 9}  # H.273's matrix 12 follows from the primaries

WHITE, PEAK = REFERENCE_WHITE, HLG_PEAK  # cd/m2; PEAK is that of most PQ masters, too
PQ, HLG = 16, 18
BLACK_OF_255, SPAN_OF_255 = 16, 219  # of limited range
DEEP = 65535  # largest value of 16 bits
# Of libswscale: SWS_BILINEAR, SWS_ACCURATE_RND, SWS_FULL_CHR_H_INT
BILINEAR, ACCURATE, ALL_CHROMA = 2, 0x40000, 0x2000
ROWS = 256  # at a time


def _to_pq(light: Light) -> Light:
    root = (light / 1e4) ** (1305 / 8192)
    return np.asarray(((0.8359375 + 18.8515625 * root) / (1 + 18.6875 * root)) ** (2523 / 32))


LIKE_SRGB = (1, 6, 7, 11, 12, 13, 14, 15)
"""Transfers of cameras that are close to BT.709's. Their signals are shown on sRGB screens as they
are, by browsers, players and editors, so they count as sRGB."""
TRANSFERS: dict[int, tuple[str, Callable[[Light], Light]]] = {  # H.273, table 3: name, light
    **dict.fromkeys(LIKE_SRGB, ("", srgb_curve)),
    4: ("gamma 2.2", lambda v: v**2.2),
    5: ("gamma 2.8", lambda v: v**2.8),
    8: ("linear", lambda v: v),
    9: ("logarithmic", lambda v: np.where(v > 0, 10 ** (2 * (v - 1)), 0)),
    10: ("logarithmic", lambda v: np.where(v > 0, 10 ** (2.5 * (v - 1)), 0)),
    PQ: ("PQ", lambda v: pq_light(v) / WHITE),
    17: ("SMPTE ST 428", lambda v: 52.37 / 48 * v**2.6),
    HLG: ("HLG", hlg_scene),
}


@dataclass(frozen=True, kw_only=True)
class Colours:
    """How a stream's pixels are read: numbers of H.273.

    Attributes:
        matrix: of luma and chroma.
        primaries: of red, green, blue.
        transfer: from light to signal.
        full: whether the values use the whole range.
        direct: whether pixels are grey or RGB: without a matrix, and full for libswscale.
        assumed: what the stream does not name, in words.
    """

    matrix: int
    primaries: int
    transfer: int
    full: bool
    direct: bool
    assumed: str = ""

    @property
    def plain(self) -> bool:
        """Whether RGB of libswscale is sRGB."""
        unscaled = self.full or not self.direct
        return self.primaries == 1 and self.transfer in LIKE_SRGB and unscaled

    def words(self) -> list[str]:
        """What users should know, in sentences."""
        said = [f"The video names no {self.assumed}."] if self.assumed else []
        names = (NAMES[self.primaries], TRANSFERS[self.transfer][0])
        if self.transfer in (PQ, HLG):
            said.append(
                f"Its HDR colours ({', '.join(names)}) are tone-mapped to sRGB: up to {PEAK:.0f}"
                f" cd/m2, with the reference white at {WHITE:.0f} cd/m2."
            )
        elif not self.plain and (self.primaries != 1 or names[1]):
            said.append(
                f"Its colours ({', '.join(filter(None, names))}) are converted to sRGB;"
                " those outside sRGB are clipped."
            )
        return said


def colours_of(tags: Any, frame: Any) -> Colours:
    """The colours of a stream.

    Args:
        tags: PyAV's codec context, which has decoded the frame.
        frame: for its size and pixel format.

    Untagged video is BT.709 from 720 lines or 1280 pixels a line on, else BT.601 of its number of
    lines. Raises SceneError for colours that are not supported; it names them.
    """
    layout, codec = frame.format, str(tags.name)
    grey = len(layout.components) - layout.name.startswith("ya") == 1 and not layout.has_palette
    direct = grey or layout.is_rgb or layout.has_palette
    primaries, transfer, matrix = (
        int(tag) for tag in (tags.color_primaries, tags.color_trc, tags.colorspace)
    )
    _check_dolby_vision(tags, frame, transfer)
    named = matrix not in UNKNOWN, primaries not in UNKNOWN, transfer not in UNKNOWN
    if not named[2]:
        transfer = 1
    large = frame.width >= 1280 or frame.height >= 720
    if not named[0]:
        matrix = _usual_matrix(primaries, transfer, large)
    if not named[1]:
        primaries = _usual_primaries(matrix, large or codec == "mjpeg" or direct, frame.height)
    if matrix == 12:
        matrix = DERIVED.get(primaries, matrix)
    if direct:
        matrix = 1
    for what, number, known in (
        ("matrix", matrix, MATRICES),
        ("primaries", primaries, PRIMARIES),
        ("transfer", transfer, TRANSFERS),
    ):
        if number not in known:
            raise _not_supported(f"{what} {number} of ITU-T H.273")
    limited = (not direct) or (grey and codec in ("h264", "hevc", "av1"))
    full = {1: False, 2: True}.get(int(tags.color_range), not limited)
    return Colours(
        matrix=matrix,
        primaries=primaries,
        transfer=transfer,
        full=full or layout.name.startswith("yuvj"),
        direct=direct,
        assumed="" if direct or codec == "mjpeg" else _assumed(named, matrix, primaries),
    )


def _assumed(named: tuple[bool, bool, bool], matrix: int, primaries: int) -> str:
    if all(named[:2]):  # nearly all transfers look the same
        return ""
    if named[0] or named[1]:
        what = "primaries" if named[0] else "colour matrix"
        used = NAMES[primaries] if named[0] else MATRICES[matrix]
        return f"{what}: {used} is assumed"
    return f"colours: {NAMES[primaries]} is assumed"


def _usual_matrix(primaries: int, transfer: int, large: bool) -> int:
    if primaries == 9 or transfer in (PQ, HLG):
        return 9
    if primaries in (1, 5, 6, 7):
        return primaries
    return 1 if large else 6


def _usual_primaries(matrix: int, large: bool, lines: int) -> int:
    if matrix in (1, 9):
        return matrix
    if large:
        return 1
    return 6 if lines <= 486 else 5  # systems of 525 and of 625 lines


def _check_dolby_vision(tags: Any, frame: Any, transfer: int) -> None:
    """SceneError if only Dolby Vision's own metadata say what the pixels mean (profile 5)."""
    tag = str(tags.codec_tag)[:3] in ("dvh", "dva", "dav")
    metadata = frame.side_data.get("DOVI_METADATA") is not None
    if transfer in UNKNOWN and (tag or metadata):
        raise _not_supported("Dolby Vision without HLG or PQ")


def _not_supported(what: str) -> SceneError:
    return SceneError(
        f"The video's colours are not supported: {what}.", "Convert it to BT.709, HLG or PQ."
    )


def to_srgb(frame: Any, colours: Colours, width: int) -> Pixels:
    """(H, width, 3) sRGB of a frame of PyAV, as stored: neither turned nor mirrored."""
    frame.colorspace = colours.matrix
    frame.color_range = 2 if colours.full or colours.direct else 1

    def rgb(form: str, interpolation: int) -> NDArray[Any]:
        size = {"width": width, "height": frame.height}
        made = frame.reformat(**size, format=form, interpolation=interpolation)
        return np.asarray(made.to_ndarray())

    if colours.plain:
        # Without these, grey gets a tint of up to 3 of 255. Ordinary video, where it is 2 at most,
        # keeps its values of earlier versions.
        ordinary = colours.matrix == 1 and not colours.full and frame.format.name == "yuv420p"
        return rgb("rgb24", BILINEAR if ordinary else BILINEAR | ACCURATE | ALL_CHROMA)
    deep = rgb("rgb48le", BILINEAR | ACCURATE)  # libswscale has a fault with ALL_CHROMA here
    convert = _Conversion(colours)
    result = np.empty(deep.shape, np.uint8)
    for top in range(0, len(deep), ROWS):
        result[top : top + ROWS] = convert(deep[top : top + ROWS])
    return result


class _Conversion:
    """From RGB of 16 bits to sRGB of 8."""

    def __init__(self, colours: Colours) -> None:
        signal = np.arange(DEEP + 1) / DEEP
        if colours.direct and not colours.full:
            signal = (signal * 255 - BLACK_OF_255) / SPAN_OF_255
        self._transfer = colours.transfer
        _, light_of = TRANSFERS[colours.transfer]
        self._light = light_of(np.clip(signal, 0, 1)).astype(np.float32)
        own = _to_xyz(PRIMARIES[colours.primaries])
        self._luminance = own[1].astype(np.float32)
        self._matrix = (np.linalg.inv(_to_xyz(SRGB)) @ own).astype(np.float32)

    def __call__(self, rgb: NDArray[np.uint16]) -> Pixels:
        light = self._light[rgb]
        if self._transfer == HLG:  # BT.2100's OOTF for a screen of 1000 cd/m2
            luminance = light @ self._luminance
            light *= (luminance**0.2 * np.float32(PEAK / WHITE))[..., None]
        light = light @ self._matrix.T
        if self._transfer in (PQ, HLG):
            brightest = light.max(axis=-1)
            light *= np.interp(brightest, LIGHTS, SCALES).astype(np.float32)[..., None]
        np.clip(light, 0, 1, out=light)
        return ENCODED[(light * DEEP + 0.5).astype(np.uint16)]


def _to_xyz(primaries: Primaries) -> Light:
    """3 x 3, from linear RGB to XYZ, adapted to D65 by Bradford's method."""
    places = np.array(primaries).reshape(4, 2)
    columns = np.column_stack([places, 1 - places.sum(axis=1)]).T
    white, daylight = (xyz / xyz[1] for xyz in (columns[:, 3], np.array([*D65, 1 - sum(D65)])))
    matrix = columns[:, :3] * np.linalg.solve(columns[:, :3], white)
    gains = (BRADFORD @ daylight) / (BRADFORD @ white)
    return np.asarray(np.linalg.inv(BRADFORD) @ (gains[:, None] * BRADFORD) @ matrix)


def _tone_mapped(light: Light) -> Light:
    """Light of HDR, 1 at its reference white, for a screen whose peak that is.

    ITU-R BT.2390, section 5.4.1: unchanged up to 98 cd/m2, above a spline in PQ that ends at PEAK.
    """
    peak = _to_pq(np.array(PEAK))
    most = float(_to_pq(np.array(WHITE)) / peak)
    knee = 1.5 * most - 0.5
    value = np.clip(_to_pq(light * WHITE) / peak, 0, 1)
    t = (value - knee) / (1 - knee)
    spline = (
        (2 * t**3 - 3 * t**2 + 1) * knee
        + (t**3 - 2 * t**2 + t) * (1 - knee)
        + (3 * t**2 - 2 * t**3) * most
    )
    return np.where(value < knee, light, pq_light(np.maximum(spline, 0) * peak) / WHITE)


LIGHTS = np.geomspace(1e-4, 1e4 / WHITE * 2, 4096)
SCALES = _tone_mapped(LIGHTS) / LIGHTS
ENCODED = (srgb_values(np.arange(DEEP + 1) / DEEP) * 255).round().astype(np.uint8)
