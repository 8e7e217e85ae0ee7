"""Videos: which frames become photos, upright, resumed; what is no video is one line."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.context import QUIET, Context
from roigs_engine.errors import EngineError, SceneError, Stopped
from roigs_engine.formats.events import Event, Progress
from roigs_engine.reconstruction.folder import Folder
from roigs_engine.reconstruction.video import (
    Seen,
    Video,
    _remembered,
    choose,
    picture_of,
    take_frames,
)
from tests.engine.commands.command_line import refused

av = pytest.importorskip("av")

SIZE = (320, 240)


def texture(seed: int = 0) -> np.ndarray:
    """A wall of large, middle and small blots, larger than the picture."""
    random, wall = np.random.default_rng(seed), np.zeros((400, 1200))
    for side in (100, 20, 3):
        noise = random.integers(0, 85, (400 // side, 1200 // side), dtype=np.uint8)
        wall += np.asarray(Image.fromarray(noise).resize((1200, 400), Image.Resampling.BICUBIC))
    return wall.astype(np.uint8)


def film(
    path: Path, shifts: list[int], *, blurred: tuple[int, ...] = (), turned: int = 0, seed: int = 0
) -> Path:
    """A pan along the wall: the picture's left edge at these pixels."""
    wall = texture(seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as video:
        stream = video.add_stream("mpeg4", rate=Fraction(10), options={"q:v": "2"})
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        if turned:
            stream.set_display_rotation(turned)
        for number, left in enumerate(shifts):
            picture = Image.fromarray(wall[: SIZE[1], left : left + SIZE[0]])
            if number in blurred:
                picture = picture.resize((32, 24)).resize(SIZE)
            frame = av.VideoFrame.from_image(picture.convert("RGB"))
            video.mux(stream.encode(frame))
        video.mux(stream.encode(None))
    return path


def taken(path: Path, out: Path, wanted: int = 0, context: Context = QUIET) -> list[int]:
    folder = Folder(out)
    folder.work().mkdir(parents=True, exist_ok=True)
    files = take_frames(path, folder, wanted, context)
    assert all(file.is_file() for file in files.values())
    return [int(name[6:12]) for name in sorted(files)]


@dataclass(frozen=True, kw_only=True)
class Pan:
    """A short video, the project of four of its frames, their numbers and what was said."""

    path: Path
    scene: Path
    numbers: list[int]
    said: list[str]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Pan:
    """Only to read."""
    folder, said = tmp_path_factory.mktemp("pan"), list[str]()
    path = film(folder / "pan.mp4", list(range(0, 200, 8)))
    context = Context(emit=lambda event: said.append(getattr(event, "text", "")))
    numbers = taken(path, folder / "scene", 4, context)
    return Pan(path=path, scene=folder / "scene", numbers=numbers, said=said)


@pytest.fixture
def pan(made: Pan, tmp_path: Path) -> Pan:
    """With a project of the test's own."""
    return replace(made, scene=shutil.copytree(made.scene, tmp_path / "pan"))


def test_equal_and_blurred_frames_are_left_out(tmp_path: Path) -> None:
    lefts = [0] * 15 + list(range(0, 600, 8))
    path = film(tmp_path / "a pan.mp4", lefts, blurred=(20, 40, 41, 60))
    numbers = taken(path, tmp_path / "scene")
    assert len(numbers) >= 25
    assert sum(number < 15 for number in numbers) <= 1
    assert not {20, 40, 41, 60} & set(numbers)
    assert np.diff([lefts[number] for number in numbers]).max() <= 48


def test_so_many_frames_are_used_as_asked_for(tmp_path: Path) -> None:
    path = film(tmp_path / "pan.mkv", list(range(0, 800, 16)))
    assert len(taken(path, tmp_path / "scene", 10)) == 10
    assert len(taken(path, tmp_path / "scene", 20)) in (19, 20)


def test_the_sharpest_of_each_part_is_chosen() -> None:
    seen = [
        Seen(number=number, moved=number / 100, sharpness=1.0 + (number % 10 == 7))
        for number in range(100)
    ]
    assert [frame.number for frame in choose(seen, 10)] == list(range(7, 100, 10))
    assert choose([]) == []


@pytest.mark.parametrize("turned", [0, 90, 180, -90])
def test_frames_are_upright(tmp_path: Path, turned: int) -> None:
    path = film(tmp_path / "phone.mov", list(range(0, 200, 20)), turned=turned)
    taken(path, tmp_path / "scene", 4)
    number, file = sorted(
        (int(file.stem[6:]), file) for file in (tmp_path / "scene/images").iterdir()
    )[1]
    stored = texture()[: SIZE[1], number * 20 : number * 20 + SIZE[0]]
    shown = np.rot90(stored, turned // 90)
    with Image.open(file) as photo:
        pixels = np.asarray(photo.convert("L")).astype(float)
        assert not photo.getexif()
    assert pixels.shape == shown.shape
    assert np.corrcoef(pixels.ravel(), shown.ravel())[0, 1] > 0.98


def shot(path: Path) -> tuple[Video, list[np.ndarray]]:
    """The video, and all its frames as photos."""
    video, found = Video(path), []
    for _, frame in video.frames():
        assert video.colours is not None
        found.append(picture_of(frame, video.ratio, video.colours).astype(int))
    return video, found


def written(path: Path, codec: str, pictures: list[np.ndarray], **settings: object) -> Path:
    """A video of (H, W, 3) pictures; settings of the codec, or `options` and `display`."""
    with av.open(str(path), "w") as video:
        options = settings.pop("options", {})
        stream = video.add_stream(codec, rate=Fraction(25), options=options)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = str(settings.pop("pix_fmt", "yuv420p"))
        if display := settings.pop("display", None):
            stream.set_display_matrix(display)
        for name, value in settings.items():
            setattr(stream.codec_context, name, value)
        for picture in pictures:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture))
            video.mux(stream.encode(frame.reformat(format=stream.pix_fmt)))
        video.mux(stream.encode(None))
    return path


@pytest.mark.parametrize(
    ("display", "shown"),
    [
        ((1, 0, 0, 1), lambda p: p),
        ((-1, 0, 0, 1), lambda p: p[:, ::-1]),
        ((1, 0, 0, -1), lambda p: p[::-1]),
        ((-1, 0, 0, -1), lambda p: p[::-1, ::-1]),
        ((0, 1, -1, 0), lambda p: np.rot90(p, -1)),
        ((0, -1, 1, 0), lambda p: np.rot90(p)),
        ((0, 1, 1, 0), lambda p: p.transpose(1, 0, 2)),
        ((0, -1, -1, 0), lambda p: p[::-1, ::-1].transpose(1, 0, 2)),
    ],
)
def test_frames_are_turned_and_mirrored(
    tmp_path: Path, display: tuple[int, ...], shown: Callable[[np.ndarray], np.ndarray]
) -> None:
    picture = np.repeat(texture()[:48, :64, None], 3, axis=2)
    a, b, c, d = (65536 * number for number in display)
    matrix = (a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path = written(tmp_path / "a.mov", "mpeg4", [picture], display=matrix, options={"q:v": "2"})
    (found,) = shot(path)[1]
    right = shown(picture)
    assert found.shape == right.shape
    assert np.corrcoef(found.ravel(), right.ravel())[0, 1] > 0.98


INTERLACED_DCT, INTERLACED_ME = 1 << 18, 1 << 29  # FFmpeg's flags of a codec
FIELDS = INTERLACED_DCT | INTERLACED_ME


@pytest.mark.parametrize(
    ("name", "codec", "settings"),
    [
        ("camcorder.MTS", "libx264", {"options": {"x264-params": "tff=1"}, "flags": FIELDS}),
        ("tape.mpg", "mpeg2video", {"options": {"q:v": "2"}, "flags": FIELDS}),
        ("edited.mov", "prores_ks", {"flags": INTERLACED_DCT, "pix_fmt": "yuv422p10le"}),
        ("tagged.mkv", "ffv1", {"field_order": 2}),  # its frames carry no flag
    ],
)
def test_interlaced_frames_are_deinterlaced(
    tmp_path: Path, name: str, codec: str, settings: dict[str, object]
) -> None:
    wall, pictures = np.repeat(texture()[:96, :, None], 3, axis=2), []
    for left in range(0, 80, 10):
        picture = wall[:, left : left + 128].copy()
        picture[1::2] = wall[1::2, left + 5 : left + 133]  # the lines of the second field
        pictures.append(picture)
    video, found = shot(written(tmp_path / name, codec, pictures, **settings))
    assert len(found) == len(pictures) and not video.damaged
    assert combs(found[3]) < 0.4 * combs(pictures[3].astype(int))
    assert "It is interlaced: it was deinterlaced." in video.words()


def combs(picture: np.ndarray) -> float:
    """Mean difference of lines from those beside them."""
    beside = (picture[:-2:2] + picture[2::2]) / 2
    return float(np.abs(picture[1:-1:2] - beside).mean())


def test_progressive_frames_are_not_deinterlaced(tmp_path: Path) -> None:
    pictures = [np.repeat(texture()[:96, k : k + 128, None], 3, axis=2) for k in range(4)]
    video, found = shot(written(tmp_path / "a.mkv", "ffv1", pictures, pix_fmt="yuv444p"))
    assert not video.deinterlaced
    assert np.abs(found[2] - pictures[2]).max() <= 4


def test_a_cover_picture_is_not_the_video(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as video:
        streams = [video.add_stream("mjpeg", rate=1), video.add_stream("mpeg4", rate=25)]
        for stream, side, layout in zip(streams, (32, 64), ("yuvj420p", "yuv420p"), strict=True):
            stream.width, stream.height, stream.pix_fmt = side, side, layout
        for stream, count in zip(streams, (1, 8), strict=True):
            picture = np.full((stream.height, stream.width, 3), 90, np.uint8)
            frame = av.VideoFrame.from_ndarray(picture).reformat(format=stream.pix_fmt)
            for number in range(count):
                frame.pts = number
                video.mux(stream.encode(frame))
            video.mux(stream.encode(None))
    found = shot(path)[1]
    assert len(found) == 8 and found[0].shape == (64, 64, 3)


def test_interlaced_hevc_is_one_line(tmp_path: Path) -> None:
    pictures = [np.full((64, 64, 3), 100 + k, np.uint8) for k in range(4)]
    options = {"x265-params": "interlace=tff:log-level=none"}
    path = written(tmp_path / "a.mkv", "libx265", pictures, options=options)
    with pytest.raises(SceneError, match="interlaced HEVC, which is not supported"):
        shot(path)


def test_pixels_become_square(tmp_path: Path) -> None:
    pictures = [np.full((72, 64, 3), 100, np.uint8)]
    wide = {"sample_aspect_ratio": Fraction(16, 11), "options": {"q:v": "2"}}
    tall = wide | {"sample_aspect_ratio": Fraction(8, 9)}
    # MPEG-2 names the picture's shape, here 4 : 3.
    for name, settings, width in (("a.m2ts", wide, 96), ("b.avi", tall, 57)):
        codec = "mpeg2video" if name.endswith("ts") else "mpeg4"
        (found,) = shot(written(tmp_path / name, codec, pictures, **settings))[1]
        assert found.shape == (72, width, 3)
    odd = wide | {"sample_aspect_ratio": Fraction(10, 1)}
    with pytest.raises(SceneError, match="10 times as wide as high"):
        shot(written(tmp_path / "c.avi", "mpeg4", pictures, **odd))


def test_what_was_assumed_and_converted_is_said_once(made: Pan) -> None:
    (line,) = [text for text in made.said if "names no colours" in text]
    assert line == "The video names no colours: BT.601 (525 lines) is assumed."
    assert sum("converted to sRGB" in text for text in made.said) == 1


def test_frames_of_an_earlier_version_are_written_again(pan: Pan) -> None:
    before = {file: file.read_bytes() for file in (pan.scene / "images").iterdir()}
    record = pan.scene / "reconstruction/video.json"
    record.write_text(json.dumps(json.loads(record.read_text("utf-8")) | {"version": 1}))
    for file in before:
        file.write_bytes(b"in the colours of that version")
    own = pan.scene / "images/frame_of_a_door.jpg"
    before[own] = b"a photo that somebody has put there"
    own.write_bytes(before[own])
    taken(pan.path, pan.scene, 4)
    assert {file: file.read_bytes() for file in (pan.scene / "images").iterdir()} == before


@pytest.mark.parametrize("damage", [{"frames": [[None, None]]}, {"damaged": None}], ids=repr)
def test_a_damaged_record_is_made_again(pan: Pan, damage: dict[str, object]) -> None:
    record = pan.scene / "reconstruction/video.json"
    whole = json.loads(record.read_text("utf-8"))
    record.write_text(json.dumps({**whole, **damage}), encoding="utf-8")
    assert taken(pan.path, pan.scene, 4) == pan.numbers
    assert json.loads(record.read_text("utf-8"))["frames"] == whole["frames"]


@pytest.mark.parametrize(
    "frames",
    [
        *(None, 7, [7], [[1]], [["x", 1]], [[None, None]], {}),
        *([[0, number]] * 9 for number in (float("nan"), 1e300, 10**400)),
    ],
    ids=repr,
)
def test_damaged_rows_of_a_record_are_not_used(made: Pan, frames: object) -> None:
    record = json.loads((made.scene / "reconstruction/video.json").read_text("utf-8"))
    assert len(_remembered(record)) == 25
    assert _remembered(record | {"frames": frames}) == []


def test_a_stop_is_resumed_and_nothing_is_done_twice(tmp_path: Path) -> None:
    path, done = film(tmp_path / "pan.mp4", list(range(0, 400, 8))), list[str]()
    asked = False

    def emit(event: Event) -> None:
        nonlocal asked
        if isinstance(event, Progress):
            done.append(event.stage)
            asked = done.count("write frames") == 3

    stopping = Context(emit=emit, should_stop=lambda: asked)
    with pytest.raises(Stopped):
        taken(path, tmp_path / "scene", 8, stopping)
    images = tmp_path / "scene/images"
    before = {file.name: file.stat().st_mtime_ns for file in images.iterdir()}
    assert len(before) == 3
    asked, rest = False, list[str]()
    numbers = taken(
        path, tmp_path / "scene", 8, Context(emit=lambda e: rest.append(type(e).__name__))
    )
    assert len(numbers) == len(list(images.iterdir())) == 8
    assert all((images / name).stat().st_mtime_ns == then for name, then in before.items())
    assert rest.count("Progress") == 5
    record = json.loads((tmp_path / "scene/reconstruction/video.json").read_text("utf-8"))
    assert len(record["frames"]) == 50


def test_a_truncated_video_is_used_as_far_as_it_goes(tmp_path: Path) -> None:
    whole = film(tmp_path / "whole.mkv", list(range(0, 400, 8))).read_bytes()
    path = tmp_path / "cut.mkv"
    path.write_bytes(whole[: len(whole) // 2])
    said = list[str]()
    numbers = taken(path, tmp_path / "scene", 5, Context(emit=lambda e: said.append(repr(e))))
    assert len(numbers) == 5 and numbers[-1] < 35


def test_what_is_no_video_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cut = film(tmp_path / "cut.mp4", list(range(0, 200, 8)))
    cut.write_bytes(cut.read_bytes()[:4000])
    (tmp_path / "text.mp4").write_text("this is no video\n" * 1000)
    (tmp_path / "empty.mov").write_bytes(b"")
    for name in ("cut.mp4", "text.mp4", "empty.mov", "missing.avi"):
        line = refused(capsys, "reconstruct", tmp_path / name, "--out", tmp_path / "scene")
        assert "Cannot read the video" in line and name in line
    os.mkfifo(tmp_path / "pipe.mp4")
    (tmp_path / "link.mp4").symlink_to(tmp_path / "pipe.mp4")
    (tmp_path / "device.mp4").symlink_to("/dev/zero")
    (tmp_path / "list.mp4").write_text("ffconcat version 1.0\nfile cut.mp4\n")
    (tmp_path / "play.mp4").write_text("#EXTM3U\n#EXTINF:1,\ncut.mp4\n#EXT-X-ENDLIST\n")
    for name in ("pipe.mp4", "link.mp4", "device.mp4", "list.mp4", "play.mp4"):
        line = refused(capsys, "reconstruct", tmp_path / name, "--out", tmp_path / "scene")
        assert "Cannot read the video" in line and name in line
    still = film(tmp_path / "still.mp4", [0] * 20)
    with pytest.raises(SceneError, match="hardly moves"):
        taken(still, tmp_path / "still")
    line = refused(capsys, "reconstruct", tmp_path, "--out", tmp_path / "scene", "--frames", 5)
    assert "is no video" in line


def test_frames_larger_than_photos_can_be_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = film(tmp_path / "large.mp4", [0, 50])
    monkeypatch.setattr("roigs_engine.reconstruction.video.MAX_PIXELS", SIZE[0] * SIZE[1] - 1)
    with pytest.raises(SceneError, match=r"No frame of .*large\.mp4 can be decoded \(of up to"):
        next(Video(path).frames())


def test_frames_of_another_video_are_not_mixed_in(pan: Pan, tmp_path: Path) -> None:
    before = {file: file.read_bytes() for file in (pan.scene / "images").iterdir()}
    with pytest.raises(SceneError, match="frames of another video"):
        taken(film(tmp_path / "two.mp4", [0, 9, 18], seed=1), pan.scene, 4)
    assert {file: file.read_bytes() for file in (pan.scene / "images").iterdir()} == before


def test_a_missing_pyav_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(EngineError, match="Reading videos needs av"):
        Video(tmp_path / "walk.mp4")


def test_an_unknown_codec_is_one_line(tmp_path: Path) -> None:
    path = film(tmp_path / "a.mkv", list(range(0, 80, 8)))
    path.write_bytes(path.read_bytes().replace(b"V_MPEG4/ISO/ASP", b"V_MPEG4/ISO/XXX"))
    with pytest.raises(SceneError, match="unknown codec"):
        taken(path, tmp_path / "scene")


def test_a_title_that_is_no_text_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as video:
        video.metadata["title"] = "TITLE"
        stream = video.add_stream("mpeg4", rate=Fraction(10))
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for left in range(0, 160, 8):
            picture = Image.fromarray(texture()[: SIZE[1], left : left + SIZE[0]])
            video.mux(stream.encode(av.VideoFrame.from_image(picture.convert("RGB"))))
        video.mux(stream.encode(None))
    path.write_bytes(path.read_bytes().replace(b"TITLE", b"\xfd\xfe\xff\xfd\xf0"))
    assert len(taken(path, tmp_path / "scene", 4)) >= 2
