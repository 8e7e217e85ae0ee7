"""Converts the colours of a video to sRGB by its tags (ITU-T H.273, VUI of H.264 and HEVC).

libswscale applies range and matrix. Primaries and transfer are converted here. HDR is tone-mapped
with one curve for all frames, because photogrammetry needs the same colour for a point in each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..photos.profiles import (
    CURVES,
    HLG,
    HLG_PEAK,
    LIKE_SRGB,
    PQ,
    PRIMARIES,
    REFERENCE_WHITE,
    encoded,
    parts_of,
    pq_light,
    space_of,
)

Pixels = NDArray[np.uint8]
Light = NDArray[np.float64]

UNKNOWN = (0, 2, 3)  # values that are reserved or unspecified
MATRICES = {1: "BT.709", 4: "FCC", 5: "BT.601", 6: "BT.601", 7: "SMPTE 240M", 9: "BT.2020"}
DERIVED = {1: 1, 5: 5, 6: 6, 9: 9}  # H.273's matrix 12 follows from the primaries

WHITE, PEAK = REFERENCE_WHITE, HLG_PEAK  # cd/m2; most PQ masters also have this peak
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # of linear sRGB (BT.709)
# Flags of libswscale: SWS_BILINEAR, SWS_ACCURATE_RND, SWS_FULL_CHR_H_INT.
BILINEAR, ACCURATE, ALL_CHROMA = 2, 0x40000, 0x2000


def _to_pq(light: Light) -> Light:
    root = (light / 1e4) ** (1305 / 8192)
    return np.asarray(((0.8359375 + 18.8515625 * root) / (1 + 18.6875 * root)) ** (2523 / 32))


@dataclass(frozen=True, kw_only=True)
class Colours:
    """The interpretation of a stream's pixels: numbers of H.273.

    Attributes:
        matrix: of luma and chroma.
        primaries: of red, green, blue.
        transfer: from light to signal.
        full: whether the values use the whole range.
        direct: whether pixels are grey or RGB: without a matrix, and full for libswscale.
        assumed: tags that the stream lacks, in words.
    """

    matrix: int
    primaries: int
    transfer: int
    full: bool
    direct: bool
    assumed: str = ""

    @property
    def plain(self) -> bool:
        """Whether libswscale's RGB is already sRGB."""
        unscaled = self.full or not self.direct
        return self.primaries == 1 and self.transfer in LIKE_SRGB and unscaled

    def words(self) -> list[str]:
        """Sentences for the user."""
        said = [f"The video names no {self.assumed}."] if self.assumed else []
        names = (PRIMARIES[self.primaries][0], CURVES[self.transfer][0])
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
    """Determine the colours of a stream.

    Args:
        tags: PyAV's codec context, which has decoded the frame.
        frame: for its size and pixel format.

    Untagged video counts as BT.709 from 720 lines or 1280 pixels a line on, otherwise as BT.601 for
    its number of lines. SceneError: the colours are not supported; the message names them.
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
        ("transfer", transfer, CURVES),
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
        used = PRIMARIES[primaries][0] if named[0] else MATRICES[matrix]
        return f"{what}: {used} is assumed"
    return f"colours: {PRIMARIES[primaries][0]} is assumed"


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
    """Raise SceneError if pixels need Dolby Vision's own metadata (profile 5)."""
    tag = str(tags.codec_tag)[:3] in ("dvh", "dva", "dav")
    metadata = frame.side_data.get("DOVI_METADATA") is not None
    if transfer in UNKNOWN and (tag or metadata):
        raise _not_supported("Dolby Vision without HLG or PQ")


def _not_supported(what: str) -> SceneError:
    return SceneError(
        f"The video's colours are not supported: {what}.", "Convert it to BT.709, HLG or PQ."
    )


def to_srgb(frame: Any, colours: Colours, width: int) -> Pixels:
    """Convert a frame of PyAV to (H, width, 3) sRGB; neither turned nor mirrored."""
    frame.colorspace = colours.matrix
    frame.color_range = 2 if colours.full or colours.direct else 1

    def rgb(form: str, interpolation: int) -> NDArray[Any]:
        size = {"width": width, "height": frame.height}
        made = frame.reformat(**size, format=form, interpolation=interpolation)
        return np.asarray(made.to_ndarray())

    if colours.plain:
        # Without these flags, grey gets a tint of up to 3 of 255. For ordinary video, it is at most
        # 2, and the values stay as in earlier versions.
        ordinary = colours.matrix == 1 and not colours.full and frame.format.name == "yuv420p"
        return rgb("rgb24", BILINEAR if ordinary else BILINEAR | ACCURATE | ALL_CHROMA)
    deep = rgb("rgb48le", BILINEAR | ACCURATE)  # libswscale has a bug with ALL_CHROMA here
    curve, limited = CURVES[colours.transfer][1], colours.direct and not colours.full
    space = space_of(PRIMARIES[colours.primaries][1], curve, limited=limited)
    if colours.transfer not in (PQ, HLG):
        return space.to_srgb(deep)
    result = np.empty(deep.shape, np.uint8)
    for part, made in zip(parts_of(deep), parts_of(result), strict=True):
        made[:] = encoded(_sdr(space.light(part), colours.transfer))
    return result


def _sdr(light: NDArray[np.float32], transfer: int) -> NDArray[np.float32]:
    """Tone-map linear sRGB light of an HDR video."""
    if transfer == HLG:  # BT.2100's OOTF for a screen of 1000 cd/m2
        luminance = np.maximum(light @ LUMINANCE, 0)
        light = light * (luminance**0.2 * np.float32(PEAK / WHITE))[..., None]
    scale = np.interp(light.max(axis=-1), LIGHTS, SCALES)
    return np.asarray(light * scale.astype(np.float32)[..., None])


def _tone_mapped(light: Light) -> Light:
    """Tone-map HDR light (1: reference white) for a screen whose peak is the reference white.

    ITU-R BT.2390, section 5.4.1: unchanged up to 98 cd/m2; above, a spline in PQ that ends at PEAK.
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
