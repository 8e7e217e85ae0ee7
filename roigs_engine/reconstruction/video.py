"""A video's frames, one after the other, upright; imports PyAV when it is used."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import EngineError, SceneError
from ..formats.projects import VIDEOS

ENDS_EARLY = 0.98  # of the frames that the file's header promises
Pixels = NDArray[np.uint8]


def is_video(path: Path) -> bool:
    """Whether the path names a video, by its ending."""
    return path.suffix.lower() in VIDEOS and not path.is_dir()


def av_module() -> Any:
    """The module `av`; EngineError if it is not installed."""
    try:
        import av
    except ImportError as error:
        raise EngineError(
            f"Reading videos needs PyAV, which is not installed ({error}).",
            "Run: pip install av (Blender: set up the engine again). Or give a folder of frames.",
        ) from error
    return av


class Video:
    """A video that is read as a stream: only a few frames are in memory at a time.

    Attributes:
        path: of the file.
        expected: number of frames by the file's header; 0: it does not say.
        ratio: width of a pixel by its height.
        damaged: whether the last pass left frames out, or ended early.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.expected = 0
        self.ratio = 1.0
        self.damaged = False
        self._av = av_module()

    def frames(self) -> Iterator[tuple[int, Any]]:
        """The number of each frame, from 0, and the frame; the same in every pass.

        Frames that cannot be decoded are left out.

        Raises:
            SceneError: the file cannot be read, or is no video.
        """
        number = 0
        try:
            # The prefix keeps names such as "concat:..." from being more than names.
            with self._av.open(f"file:{self.path.absolute()}") as file:
                if not file.streams.video:
                    raise SceneError(f"{self.path} has no pictures.", "Give a video.")
                stream = file.streams.video[0]
                stream.thread_type = "AUTO"
                self.expected, self.damaged = stream.frames, False
                self.ratio = float(stream.sample_aspect_ratio or 1)
                for packet in self._packets(file, stream):
                    try:
                        decoded = packet.decode()
                    except self._av.error.FFmpegError:
                        self.damaged = True
                        continue
                    for frame in decoded:
                        yield number, frame
                        number += 1
        except (self._av.error.FFmpegError, OSError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise SceneError(
                f"Cannot read the video {self.path} ({reason}).",
                "Copy it again, or convert it to MP4.",
            ) from error
        if not number:
            raise SceneError(f"No frame of {self.path} can be decoded.", "Convert it to MP4.")
        self.damaged = self.damaged or number < ENDS_EARLY * self.expected

    def _packets(self, file: Any, stream: Any) -> Iterator[Any]:
        """The stream's packets, as far as they can be read."""
        packets = file.demux(stream)
        while True:
            try:
                yield next(packets)
            except StopIteration:
                return
            except self._av.error.FFmpegError:
                self.damaged = True
                return


def grey(frame: Any, side: int) -> Pixels:
    """(H, W) of a frame, its longer side at most `side`; not turned."""
    shrink = min(1.0, side / max(frame.width, frame.height))
    width, height = (max(2, round(length * shrink)) for length in (frame.width, frame.height))
    small = frame.reformat(width=width, height=height, format="gray")
    return np.asarray(small.to_ndarray(), dtype=np.uint8)


def upright(frame: Any, ratio: float) -> Pixels:
    """(H, W, 3) sRGB of a frame, turned as its metadata say, and its pixels square.

    Args:
        frame: of `Video.frames`.
        ratio: width of a pixel by its height.
    """
    width = max(2, round(frame.width * ratio))
    rgb = frame.reformat(width=width, height=frame.height, format="rgb24").to_ndarray()
    return np.ascontiguousarray(np.rot90(rgb, round(frame.rotation / 90)), dtype=np.uint8)
