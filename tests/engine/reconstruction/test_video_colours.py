"""Colours of videos: each tag of a stream, against values of the standards' formulas."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roigs_engine.errors import SceneError
from roigs_engine.reconstruction.video import Video, picture_of

av = pytest.importorskip("av")

QUIET_X265 = "log-level=none"
Colour = tuple[float, float, float]
COLOURS: tuple[Colour, ...] = (
    *((0.72, 0.35, 0.2), (0.2, 0.6, 0.3), (0.25, 0.3, 0.7)),
    *((0.5, 0.5, 0.5), (0.9, 0.85, 0.8), (0.12, 0.1, 0.08)),
)
WEIGHTS = {1: (0.2126, 0.0722), 5: (0.299, 0.114), 6: (0.299, 0.114), 9: (0.2627, 0.0593)}
WEIGHTS |= {4: (0.30, 0.11), 7: (0.212, 0.087)}
# Linear RGB -> linear sRGB: published values, to four digits.
TO_SRGB = {
    1: ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    12: ((1.2249, -0.2247, 0.0), (-0.0420, 1.0419, 0.0), (-0.0197, -0.0786, 1.0979)),
    9: ((1.6605, -0.5876, -0.0728), (-0.1246, 1.1329, -0.0083), (-0.0182, -0.1006, 1.1187)),
    6: ((0.9395, 0.0502, 0.0103), (0.0178, 0.9658, 0.0164), (-0.0016, -0.0044, 1.0060)),
    5: ((1.0440, -0.0440, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0118, 0.9882)),
}


def encoded(light: float) -> float:
    """The sRGB signal of 255 of linear light."""
    light = min(max(light, 0.0), 1.0)
    return 255 * (12.92 * light if light <= 0.0031308 else 1.055 * light ** (1 / 2.4) - 0.055)


def srgb_light(v: float) -> float:
    return v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4


def shown(colour: Colour, light_of: Callable[[float], float], primaries: int) -> list[float]:
    light = [light_of(v) for v in colour]
    rows = TO_SRGB[primaries]
    return [encoded(sum(w * x for w, x in zip(row, light, strict=True))) for row in rows]


def luma_chroma(colour: Colour, matrix: int, full: bool, bits: int) -> list[int]:
    """Y, Cb, Cr as the standards quantise them."""
    (kr, kb), (r, g, b) = WEIGHTS[matrix], colour
    y = kr * r + (1 - kr - kb) * g + kb * b
    cb, cr, most = (b - y) / (2 - 2 * kb), (r - y) / (2 - 2 * kr), 2**bits - 1
    unit = 2 ** (bits - 8)
    if full:
        return [round(y * most), *(round(c * most + 128 * unit) for c in (cb, cr))]
    return [round((16 + 219 * y) * unit), *(round((128 + 224 * c) * unit) for c in (cb, cr))]


def filmed(
    path: Path, fmt: str, planes: list[list[int]], lines: int = 24, **tags: int
) -> list[Any]:
    """Colours that a video of one frame for each value shows; planes: the values of each."""
    deep = np.uint16 if "10" in fmt or "16" in fmt else np.uint8
    with av.open(str(path), "w") as video:
        stream = video.add_stream("ffv1", rate=Fraction(25))
        stream.width, stream.height, stream.pix_fmt = 32, lines, fmt
        for name, value in tags.items():
            setattr(stream.codec_context, name, value)
        for values in planes:
            frame = av.VideoFrame(32, lines, fmt)
            for plane, value in zip(frame.planes, values, strict=False):
                plane.update(np.full(plane.buffer_size // deep().itemsize, value, deep).tobytes())
            for name, value in tags.items():
                setattr(frame, name, value)
            video.mux(stream.encode(frame))
        video.mux(stream.encode(None))
    return shots(path)[1]


def shots(path: Path) -> tuple[Video, list[Any]]:
    """The video, and the middle pixel of each frame."""
    video, found = Video(path), []
    for _, frame in video.frames():
        assert video.colours is not None
        picture = picture_of(frame, video.ratio, video.colours)
        found.append(picture[picture.shape[0] // 2, picture.shape[1] // 2].astype(int))
    return video, found


def check(found: list[Any], right: list[list[float]], within: float = 3.0) -> None:
    assert len(found) == len(right)
    assert np.abs(np.array(found) - np.array(right)).max() <= within, (found, right)


def tags_of(matrix: int, primaries: int, transfer: int, full: bool) -> dict[str, int]:
    names = ("colorspace", "color_primaries", "color_trc", "color_range")
    return dict(zip(names, (matrix, primaries, transfer, 2 if full else 1), strict=True))


@pytest.mark.parametrize("fmt", ["yuv420p", "yuv422p10le"])
@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("matrix", [1, 4, 5, 6, 7, 9])
def test_matrix_and_range(tmp_path: Path, matrix: int, full: bool, fmt: str) -> None:
    bits = 10 if "10" in fmt else 8
    values = [luma_chroma(colour, matrix, full, bits) for colour in COLOURS]
    found = filmed(tmp_path / "a.mkv", fmt, values, **tags_of(matrix, 1, 1, full))
    check(found, [[255 * v for v in colour] for colour in COLOURS])


@pytest.mark.parametrize("primaries", [5, 6, 9, 12])
def test_primaries(tmp_path: Path, primaries: int) -> None:
    values = [luma_chroma(colour, 1, False, 8) for colour in COLOURS]
    found = filmed(tmp_path / "a.mkv", "yuv444p", values, **tags_of(1, primaries, 1, False))
    check(found, [shown(colour, srgb_light, primaries) for colour in COLOURS], 4.0)


def test_another_white_becomes_white(tmp_path: Path) -> None:
    for primaries in (4, 8, 11):
        values = [luma_chroma((1, 1, 1), 1, False, 10), luma_chroma((0.5, 0.5, 0.5), 1, False, 10)]
        found = filmed(tmp_path / "a.mkv", "yuv444p10le", values, **tags_of(1, primaries, 1, False))
        check(found, [[255] * 3, [127.5] * 3], 2.0)


@pytest.mark.parametrize(
    ("transfer", "light_of"),
    [
        *((number, srgb_light) for number in (1, 6, 7, 11, 13, 14, 15)),
        (4, lambda v: v**2.2),
        (5, lambda v: v**2.8),
        (8, lambda v: v),
        (9, lambda v: 10 ** (2 * (v - 1))),
        (10, lambda v: 10 ** (2.5 * (v - 1))),
        (17, lambda v: 52.37 / 48 * v**2.6),
    ],
)
def test_transfer(tmp_path: Path, transfer: int, light_of: Callable[[float], float]) -> None:
    values = [luma_chroma(colour, 9, False, 10) for colour in COLOURS]
    found = filmed(tmp_path / "a.mkv", "yuv420p10le", values, **tags_of(9, 1, transfer, False))
    check(found, [shown(colour, light_of, 1) for colour in COLOURS])


def pq(nits: float) -> float:
    root = (nits / 10000) ** 0.1593017578125
    return float(((0.8359375 + 18.8515625 * root) / (1 + 18.6875 * root)) ** 78.84375)


def hlg(light: float) -> float:
    """HLG's signal of light of the scene, 0..1 (BT.2100)."""
    if light <= 1 / 12:
        return math.sqrt(3 * light)
    return 0.17883277 * math.log(12 * light - 0.28466892) + 0.55991073


def test_hdr_is_tone_mapped_around_its_reference_white(tmp_path: Path) -> None:
    nits = [5.0, 26.0, 60.0, 95.0]
    hdr = {
        16: [pq(n) for n in [*nits, 203, 1000, 4000]],
        18: [hlg((n / 1000) ** (1 / 1.2)) for n in [*nits, 203, 600, 1000]],
    }
    for transfer, signals in hdr.items():
        values = [luma_chroma((v, v, v), 9, False, 10) for v in signals]
        found = filmed(tmp_path / "a.mkv", "yuv420p10le", values, **tags_of(9, 9, transfer, False))
        check(found[:4], [[encoded(n / 203)] * 3 for n in nits])
        tones = [int(pixel[1]) for pixel in found]
        assert tones == sorted(tones) and 225 <= tones[4] <= 245 and tones[-1] >= 254
        assert all(np.ptp(pixel) <= 1 for pixel in found)  # grey stays grey


def test_colours_of_hdr(tmp_path: Path) -> None:
    light = (0.09, 0.05, 0.03)  # of the scene, below the bend of the curve
    luminance = sum(w * x for w, x in zip((0.2627, 0.6780, 0.0593), light, strict=True))
    signals = [hlg(x) for x in light], [pq(1000 * luminance**0.2 * x) for x in light]
    right = shown(light, lambda x: luminance**0.2 * 1000 / 203 * x, 9)
    for transfer, (r, g, b) in zip((18, 16), signals, strict=True):
        values = [luma_chroma((r, g, b), 9, False, 10)]
        check(
            filmed(tmp_path / "a.mkv", "yuv420p10le", values, **tags_of(9, 9, transfer, False)),
            [right],
        )


@pytest.mark.parametrize(("lines", "matrix", "primaries"), [(480, 6, 6), (576, 6, 5), (720, 1, 1)])
def test_untagged_video_is_of_its_size(
    tmp_path: Path, lines: int, matrix: int, primaries: int
) -> None:
    values = [luma_chroma(colour, matrix, False, 8) for colour in COLOURS[:2]]
    found = filmed(tmp_path / "a.mkv", "yuv420p", values, lines)
    check(found, [shown(colour, srgb_light, primaries) for colour in COLOURS[:2]], 4.0)
    (said, *converted) = shots(tmp_path / "a.mkv")[0].words()
    assert said == f"The video names no colours: {name_of(primaries)} is assumed."
    assert bool(converted) == (primaries != 1)


def name_of(primaries: int) -> str:
    return {1: "BT.709", 5: "BT.601 (625 lines)", 6: "BT.601 (525 lines)"}[primaries]


@pytest.mark.parametrize(
    ("tags", "matrix", "primaries"),
    [
        ({"colorspace": 9}, 9, 9),
        ({"color_primaries": 9}, 9, 9),
        ({"colorspace": 1}, 1, 1),
        ({"color_primaries": 1}, 1, 1),
        ({"color_primaries": 5}, 5, 5),
        ({"colorspace": 12, "color_primaries": 9}, 9, 9),
    ],
)
def test_one_tag_tells_the_others(
    tmp_path: Path, tags: dict[str, int], matrix: int, primaries: int
) -> None:
    values = [luma_chroma(colour, matrix, False, 10) for colour in COLOURS]
    found = filmed(tmp_path / "a.mkv", "yuv444p10le", values, **tags)
    check(found, [shown(colour, srgb_light, primaries) for colour in COLOURS], 4.0)


@pytest.mark.parametrize("limited", [False, True])
def test_grey_and_rgb_have_a_range_but_no_matrix(tmp_path: Path, limited: bool) -> None:
    def level(v: float) -> int:
        return round(16 + 219 * v) if limited else round(255 * v)

    tags = {"color_range": 1 if limited else 2}
    greys = [[level(v)] for v in (0.0, 0.1, 0.5, 1.0)]
    right = [[255 * v] * 3 for v in (0.0, 0.1, 0.5, 1.0)]
    check(filmed(tmp_path / "a.mkv", "gray", greys, **tags), right)
    gbr = [[level(v) * 257 for v in (g, b, r)] for r, g, b in COLOURS]
    found = filmed(tmp_path / "b.mkv", "gbrp16le", gbr, **tags)
    check(found, [[255 * v for v in colour] for colour in COLOURS])


def test_alpha_is_left_out(tmp_path: Path) -> None:
    values = [[*luma_chroma(colour, 1, False, 8), 40] for colour in COLOURS]
    found = filmed(tmp_path / "a.mkv", "yuva420p", values, **tags_of(1, 1, 1, False))
    check(found, [[255 * v for v in colour] for colour in COLOURS])


def test_ordinary_video_is_as_ffmpeg_converts_it(tmp_path: Path) -> None:
    values = [luma_chroma(colour, 1, False, 8) for colour in COLOURS]
    filmed(tmp_path / "a.mkv", "yuv420p", values, **tags_of(1, 1, 1, False))
    video = Video(tmp_path / "a.mkv")
    for _, frame in video.frames():
        assert video.colours is not None and not video.words()
        right = frame.to_ndarray(format="rgb24")
        assert np.array_equal(picture_of(frame, 1.0, video.colours), right)


@pytest.mark.parametrize("tags", [{"colorspace": 8}, {"colorspace": 10}, {"colorspace": 14}])
def test_an_unsupported_matrix_is_one_line(tmp_path: Path, tags: dict[str, int]) -> None:
    with pytest.raises(SceneError, match="colours are not supported: matrix"):
        filmed(tmp_path / "a.mkv", "yuv420p", [[100, 100, 100]], **tags)


def test_dolby_vision_without_a_usual_base_is_one_line(tmp_path: Path) -> None:
    with av.open(str(tmp_path / "a.mp4"), "w") as video:
        stream = video.add_stream("mpeg4", rate=Fraction(25))
        stream.width, stream.height, stream.pix_fmt = 64, 64, "yuv420p"
        video.mux(stream.encode(av.VideoFrame(64, 64, "yuv420p")))
        video.mux(stream.encode(None))
    data = (tmp_path / "a.mp4").read_bytes()
    shots(tmp_path / "a.mp4")
    (tmp_path / "b.mp4").write_bytes(data.replace(b"mp4v", b"dvh1"))  # its tag alone tells
    with pytest.raises(SceneError, match="Dolby Vision without HLG or PQ"):
        shots(tmp_path / "b.mp4")
