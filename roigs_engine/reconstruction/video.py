"""Chooses frames of a video as photos: the sharpest in each part of the camera's path.

A video is read as a stream, twice: to measure the picture's motion, and to write the chosen frames.
PyAV is imported when it is used.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..context import Context
from ..errors import SceneError
from ..formats.events import StageStarted
from ..formats.files import (
    atomic_write,
    matching,
    own_folder,
    read_record,
    regular,
    write_json,
)
from ..formats.text import counted
from ..machine import package
from ..photos.headers import MAX_PIXELS, content_digest
from .folder import IMAGES, Folder
from .photo_checks import BLURRED, fine_detail
from .video_colours import Colours, colours_of, to_srgb

CONTAINERS = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg"
"""FFmpeg's names of the formats in `projects.VIDEOS`."""
ENDS_EARLY = 0.98  # of the frames that the header promises; a file with fewer is truncated
NARROWEST, WIDEST = 0.25, 4.0  # ratio of a pixel's width and height
CONVERT = "Copy it again, or convert it to MP4."
FLAGGING = ("h264", "mpeg1video", "mpeg2video", "vc1")  # codecs that flag each interlaced frame
# FFmpeg's field order -> the field shown first.
INTERLACED = {2: "tff", 3: "bff", 4: "bff", 5: "tff"}
Pixels = NDArray[np.uint8]


class Video:
    """A video that is read as a stream: only a few frames are in memory at a time.

    Attributes:
        path: of the file.
        expected: number of frames by the file's header; 0: unknown.
        ratio: width of a pixel divided by its height.
        colours: of the frames; None before the first one.
        deinterlaced: whether a frame of the last pass was interlaced.
        damaged: whether the last pass skipped frames or ended early.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.expected = 0
        self.ratio = 1.0
        self.colours: Colours | None = None
        self.deinterlaced = False
        self.damaged = False
        otherwise = "Or give a folder of frames."
        self._av = package("av", "Reading videos", otherwise=otherwise)

    def frames(self) -> Iterator[tuple[int, Any]]:
        """Yield each frame with its number, from 0; the same in every pass.

        Frames that cannot be decoded are skipped. SceneError: the file is no video, or unreadable.
        """
        number = -1
        try:
            with open(self.path, "rb", opener=regular):
                pass  # refuses pipes and devices: reading them might never end
            # The prefix keeps FFmpeg from interpreting names such as "concat:...". The list of
            # formats excludes playlists that have a video's name and refer to other files.
            name, only = f"file:{self.path.absolute()}", {"format_whitelist": CONTAINERS}
            most = {"max_pixels": str(MAX_PIXELS)}
            # Metadata are not needed, and may be invalid text.
            with self._av.open(
                name, options=most, container_options=only, metadata_errors="replace"
            ) as file:
                if not file.streams.video:
                    raise SceneError(f"{self.path} has no pictures.", "Give a video.")
                stream = file.streams.best("video") or file.streams.video[0]
                if stream.codec_context is None:
                    raise SceneError(f"{self.path} has an unknown codec.", CONVERT)
                stream.codec_context.options = most  # a frame may have another size
                stream.thread_type = "AUTO"
                self.expected, self.damaged, self.deinterlaced = stream.frames, False, False
                for number, frame in enumerate(self._whole(stream, self._decoded(file, stream))):
                    if self.colours is None:
                        self.colours = colours_of(stream.codec_context, frame)
                        self.ratio = float(stream.sample_aspect_ratio or 1)
                        if not NARROWEST <= self.ratio <= WIDEST:
                            shape = f"{self.ratio:g} times as wide as high"
                            raise SceneError(
                                f"The pixels of {self.path} are {shape}.",
                                "Convert it to a video with square pixels.",
                            )
                    yield number, frame
        except (self._av.error.FFmpegError, OSError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise SceneError(f"Cannot read the video {self.path} ({reason}).", CONVERT) from error
        if number < 0:
            limit = f"of up to {MAX_PIXELS // 10**6} million pixels"
            text = f"No frame of {self.path} can be decoded ({limit})."
            raise SceneError(text, "Convert it to MP4.")
        self.damaged = self.damaged or number + 1 < ENDS_EARLY * self.expected

    def words(self) -> list[str]:
        """Assumptions and conversions of the last passes, in sentences; none before the first."""
        said = self.colours.words() if self.colours else []
        return [*said, "It is interlaced: it was deinterlaced."] if self.deinterlaced else said

    def _decoded(self, file: Any, stream: Any) -> Iterator[Any]:
        """Decode the file's frames, as far as its packets can be read."""
        packets = file.demux(stream)
        while True:
            try:
                if (packet := next(packets, None)) is None:
                    return
                yield from packet.decode()
            except self._av.error.FFmpegError:
                self.damaged = True

    def _whole(self, stream: Any, frames: Iterator[Any]) -> Iterator[Any]:
        """Deinterlace frames from the first interlaced one on; yields one for each frame.

        In an interlaced frame, half of the lines were taken later. If the camera moves, edges get
        combs, which look like detail.
        """
        tags = stream.codec_context
        unflagged = tags.name not in FLAGGING and INTERLACED.get(tags.field_order)
        graph, layout = None, None
        for frame in frames:
            if graph is None and not unflagged and not frame.interlaced_frame:
                yield frame
                continue
            if tags.name == "hevc":  # each picture is a single field
                text = f"{self.path} is interlaced HEVC, which is not supported."
                raise SceneError(text, "Convert it to progressive video.")
            self.deinterlaced = True
            if layout != (layout := (frame.width, frame.height, frame.format.name)):
                yield from self._filtered(graph, None)
                graph = self._deinterlacer(stream, frame, unflagged or "")
            yield from self._filtered(graph, frame)
        yield from self._filtered(graph, None)

    def _deinterlacer(self, stream: Any, frame: Any, parity: str) -> Any:
        """A graph of filters; `parity`: for frames without flags, otherwise empty."""
        graph = self._av.filter.Graph()
        size = {"width": frame.width, "height": frame.height, "format": frame.format.name}
        source = graph.add_buffer(**size, time_base=stream.time_base)
        which = f"parity={parity}:deint=all" if parity else "parity=auto:deint=interlaced"
        filters = graph.add("bwdif", f"mode=send_frame:{which}"), graph.add("buffersink")
        graph.link_nodes(source, *filters).configure()
        return graph

    def _filtered(self, graph: Any, frame: Any) -> Iterator[Any]:
        """Push a frame into a graph and yield its output; None: flush the graph."""
        if graph is None:
            return
        graph.push(frame)
        while True:
            try:
                yield graph.pull()
            except (BlockingIOError, EOFError):
                return


def grey(frame: Any, side: int) -> Pixels:
    """A frame in grey, (H, W), its longer side at most `side`; not turned."""
    shrink = min(1.0, side / max(frame.width, frame.height))
    width, height = (max(2, round(length * shrink)) for length in (frame.width, frame.height))
    small = frame.reformat(width=width, height=height, format="gray")
    return np.asarray(small.to_ndarray(), dtype=np.uint8)


def picture_of(frame: Any, ratio: float, colours: Colours) -> Pixels:
    """Convert a frame to (H, W, 3) sRGB, turned and mirrored by its metadata, with square pixels.

    `ratio`: width of a pixel divided by its height.
    """
    rgb = to_srgb(frame, colours, max(2, round(frame.width * ratio)))
    return np.ascontiguousarray(_upright(rgb, frame.side_data.get("DISPLAYMATRIX")))


def _upright(pixels: Pixels, display: Any) -> Pixels:
    """Turn pixels by a display matrix, rounded to the nearest quarter turn.

    The matrix is FFmpeg's: nine numbers of 32 bits. By the first five, (a, b, _, c, d), a pixel
    (x, y) is shown at (a x + c y, b x + d y), y down.
    """
    if display is None:
        return pixels
    a, b, _, c, d = np.frombuffer(bytes(display), np.int32)[:5].tolist()
    if abs(a) + abs(d) < abs(b) + abs(c):
        pixels, a, d = pixels.transpose(1, 0, 2), c, b
    return pixels[:: -1 if d < 0 else 1, :: -1 if a < 0 else 1]


LOOK, WRITE = "look at the video", "write frames"
FARTHEST = 1e6  # in longer sides of the picture; no camera moves so far
VERSION = 2  # increase it if other frames would be chosen
STEP = 0.05  # of the picture's longer side: motion of the picture between photos
FEWEST, MOST = 30, 300  # photos, if their number is not given
STILL = 0.004  # of the picture's longer side: frames with less motion count as equal
APART = 0.4  # of the step between photos: least distance of two photos
SHARP_SIDE, MOVED_SIDE, BLOCK = 640, 256, 64  # px
FAR = 0.15  # of a block: after this motion, a later frame becomes the reference
COARSE = 0.1  # cycles per px: finer detail has less weight in the motion
TEXTURE = 3.0  # grey levels: least contrast of a block whose motion is measured
QUALITY = 95
RECORD = "video.json"
_FRAME = re.compile(r"frame_\d{6,}\.jpg")


@dataclass(frozen=True, kw_only=True)
class Seen:
    """A frame: its number, the picture's motion up to it, and its fine detail.

    `moved` is in longer sides of the picture; `sharpness` is as in `photo_checks.Photo`.
    """

    number: int
    moved: float
    sharpness: float


def take_frames(path: Path, folder: Folder, wanted: int, context: Context) -> dict[str, Path]:
    """Write the frames of a video that become photos; name -> file. Existing files are kept.

    `wanted`: approximate number of frames; 0: derived from the motion.

    Raises:
        SceneError: the video cannot be read, shows too little, or the folder has another's frames.
        EngineError: PyAV is not installed.
        RunFolderError: the folder cannot be written.
    """
    video, images = Video(path), own_folder(folder.root, IMAGES)
    seen = _seen(video, folder, context)
    files = {f.number: images / f"frame_{f.number:06d}.jpg" for f in choose(seen, wanted)}
    if len(files) < 2:
        raise SceneError(
            f"The picture of {path} hardly moves.", "Film while you walk around the object."
        )
    missing = [number for number, file in files.items() if not file.exists()]
    if missing:
        _write(video, {number: files[number] for number in missing}, context)
    for sentence in video.words():
        context.info(sentence)
    context.info(f"{len(files)} of {counted(len(seen), 'frame')} are used as photos.")
    return {file.name: file for file in files.values()}


def _seen(video: Video, folder: Folder, context: Context) -> list[Seen]:
    """All frames; stored in the record with the video's digest."""
    path = folder.work(RECORD)
    try:
        digest = content_digest(video.path)
    except OSError as error:
        text = f"Cannot read the video {video.path} ({error.strerror or error})."
        raise SceneError(text, "Give another.") from error
    record = read_record(path)
    if record.get("video") != digest:
        if _frames_in(folder):
            raise SceneError(f"{folder.images} has frames of another video.", "Give another --out.")
        record = {}
    seen = _remembered(record)
    if not seen:
        seen = look(video, context)
        for made_before in _frames_in(folder):  # frames of another version
            made_before.unlink()
        rows = [[frame.moved, frame.sharpness] for frame in seen]
        record = {"version": VERSION, "video": digest, "frames": rows, "damaged": video.damaged}
        write_json(path, record)
    if record.get("damaged"):
        context.warn(f"Parts of {video.path} cannot be read; the other frames are used.")
    return seen


def _frames_in(folder: Folder) -> list[Path]:
    """The frames in the folder of photos; a user's `frame_of_a_door.jpg` is not one."""
    return [path for path in matching(folder.images, "*.jpg") if _FRAME.fullmatch(path.name)]


def _remembered(record: Mapping[str, Any]) -> list[Seen]:
    """The frames in a record; none if it has another version or is damaged."""
    if record.get("version") != VERSION:
        return []
    try:
        rows = np.array(record.get("frames"), dtype=np.float64).reshape(-1, 2)
    except (TypeError, ValueError, OverflowError):
        return []
    if not (np.abs(rows) < FARTHEST).all():
        return []
    return [
        Seen(number=n, moved=way, sharpness=fine) for n, (way, fine) in enumerate(rows.tolist())
    ]


def look(video: Video, context: Context) -> list[Seen]:
    """Measure every frame."""
    seen, moved, reference = [], 0.0, None
    context.emit(StageStarted(stage=LOOK, total=0))
    began = time.monotonic()
    for number, frame in video.frames():
        context.check_cancelled()
        small = grey(frame, MOVED_SIDE)
        if reference is None or reference.shape != small.shape:
            reference = small
        way = shift(reference, small)
        here = moved + way / max(small.shape)
        if way > FAR * BLOCK:
            moved, reference = here, small
        seen.append(Seen(number=number, moved=here, sharpness=fine_detail(grey(frame, SHARP_SIDE))))
        context.progress(LOOK, number + 1, max(video.expected, number + 1), began)
    return seen


def shift(before: NDArray[np.uint8], after: NDArray[np.uint8]) -> float:
    """The picture's motion, px: the mean over its blocks, each by phase correlation."""
    rows, columns = (max(1, length // BLOCK) for length in before.shape)
    height, width = before.shape[0] // rows, before.shape[1] // columns
    window = np.outer(np.hanning(height), np.hanning(width))
    found = []
    for row in range(rows):
        for column in range(columns):
            at = np.s_[row * height : (row + 1) * height, column * width : (column + 1) * width]
            blocks = [picture[at].astype(np.float64) for picture in (before, after)]
            if min(block.std() for block in blocks) >= TEXTURE:
                found.append(_block_shift(*((block - block.mean()) * window for block in blocks)))
    return float(np.mean(found)) if found else 0.0


def _block_shift(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """The length of the shift between two blocks, px."""
    spectrum = np.fft.rfft2(other) * np.conj(np.fft.rfft2(one))
    spectrum /= np.maximum(np.abs(spectrum), 1e-9)
    fine = np.hypot(np.fft.fftfreq(one.shape[0])[:, None], np.fft.rfftfreq(one.shape[1]))
    spectrum *= np.exp(-((fine / COARSE) ** 2))  # blurred frames have no fine detail
    response = np.fft.irfft2(spectrum, one.shape)
    peak = np.unravel_index(int(response.argmax()), response.shape)
    signed = [int(k) - n if k > n // 2 else int(k) for k, n in zip(peak, one.shape, strict=True)]
    return math.hypot(*signed)


def choose(seen: Sequence[Seen], wanted: int = 0) -> list[Seen]:
    """Choose the frames that become photos: the sharpest in each part of the path, in order.

    `wanted`: number of parts; 0: derived from the path's length.
    """
    way = max((frame.moved for frame in seen), default=0.0)
    parts = wanted or int(np.clip(round(way / STEP), FEWEST, MOST))
    step = way / parts
    least = max(APART * step, STILL)
    chosen: list[Seen] = []
    for part in range(parts):
        last = chosen[-1].moved if chosen else -np.inf
        low, high = part * step, (part + 1) * step if part < parts - 1 else np.inf
        inside = [f for f in seen if low <= f.moved < high and f.moved - last >= least]
        if inside:
            chosen.append(max(inside, key=lambda frame: frame.sharpness))
    usual = float(np.median([frame.sharpness for frame in chosen])) if chosen else 0.0
    return sorted(
        (frame for frame in chosen if frame.sharpness >= BLURRED * usual),
        key=lambda frame: frame.number,
    )


def _write(video: Video, missing: Mapping[int, Path], context: Context) -> None:
    context.emit(StageStarted(stage=WRITE, total=len(missing)))
    began, done, last = time.monotonic(), 0, max(missing)
    for number, frame in video.frames():
        context.check_cancelled()
        if number in missing:
            with atomic_write(missing[number], durable=False) as file:
                assert video.colours is not None  # set by the first frame
                picture = Image.fromarray(picture_of(frame, video.ratio, video.colours))
                picture.save(file, format="JPEG", quality=QUALITY, subsampling=0)
            done += 1
            context.progress(WRITE, done, len(missing), began)
        if number == last:
            return
