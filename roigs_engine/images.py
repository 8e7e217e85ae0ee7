"""Decoding photos to uint8 arrays at their camera's size, and a bounded cache of them.

Orientation tags are ignored, as COLMAP ignores them: pixels are taken as the file stores them.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from .photo_headers import open_photo, unreadable
from .scene import PosedImage

Pixels = NDArray[np.uint8]

# A JPEG is decoded at a fraction of its size only where this factor is left for the resampling.
GAP = 2.0
FALLBACK_MEMORY = 8 << 30  # bytes, where the machine does not tell


def decode(path: Path, size: tuple[int, int] | None = None) -> Pixels:
    """(H, W, 3) uint8 sRGB of a photo, resampled to `size` = (width, height) when given.

    Grey, palette, CMYK and 16-bit files are converted; an alpha channel is dropped.

    Raises:
        PhotoError: the file is missing or cannot be decoded; names it.
    """
    try:
        with open_photo(path) as photo:
            full = photo.size
            if size is not None:
                photo.draft("RGB", (round(size[0] * GAP), round(size[1] * GAP)))
            shrink = _draft_factor(full, photo.size)
            rgb = _to_rgb(photo)
    except MemoryError:
        raise
    except Exception as error:  # Pillow's readers raise nearly anything on damaged files
        raise unreadable(path, error) from error
    if size is not None and rgb.size != size:
        # The last column and row of a draft may reach past the photo: leave that share out.
        box = (0.0, 0.0, full[0] / shrink, full[1] / shrink)
        rgb = rgb.resize(size, Image.Resampling.LANCZOS, box=box)
    return np.array(rgb, dtype=np.uint8)


def load_photo(image: PosedImage) -> Pixels:
    """(H, W, 3) uint8 sRGB of a posed photo at its camera's size.

    Raises:
        PhotoError: the file is missing or cannot be decoded; names it.
    """
    return decode(image.path, (image.camera.width, image.camera.height))


def _draft_factor(full: tuple[int, int], drafted: tuple[int, int]) -> int:
    """By how much JPEG's draft mode has shrunk the photo: 1, 2, 4 or 8."""
    return next((n for n in (1, 2, 4, 8) if -(-full[0] // n) == drafted[0]), 1)


def _to_rgb(photo: Image.Image) -> Image.Image:
    """The photo as 8-bit RGB."""
    if photo.mode == "I" or photo.mode.startswith("I;16"):
        values = np.asarray(photo)
        grey = values >> 8 if values.max(initial=0) > 255 else values
        return Image.fromarray(grey.clip(0, 255).astype(np.uint8)).convert("RGB")
    if photo.mode in ("P", "PA"):
        return photo.convert("RGBA").convert("RGB")
    if photo.mode == "RGB":  # no second copy of a large photo
        photo.load()
        return photo
    return photo.convert("RGB")


def machine_memory() -> int:
    """Bytes of memory this process may count on: the machine's, or its container's limit."""
    total = FALLBACK_MEMORY
    if sys.platform == "win32":
        total = _windows_memory() or total
    else:
        with contextlib.suppress(OSError, ValueError):
            total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        limit = Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii").strip()
        return min(total, int(limit)) if limit.isdigit() else total
    except (OSError, UnicodeDecodeError):
        return total


def _windows_memory() -> int:
    """Physical memory in bytes from the Windows API, 0 when it does not answer."""
    import ctypes

    class Status(ctypes.Structure):
        _fields_ = [
            ("length", ctypes.c_ulong),
            ("load", ctypes.c_ulong),
            ("total", ctypes.c_ulonglong),
            *((f"rest{index}", ctypes.c_ulonglong) for index in range(6)),
        ]

    status = Status(length=ctypes.sizeof(Status))
    kernel = getattr(ctypes, "windll").kernel32  # noqa: B009 (absent elsewhere: not for mypy)
    return int(status.total) if kernel.GlobalMemoryStatusEx(ctypes.byref(status)) else 0


class PhotoCache:
    """Decoded photos of a scene, least recently used ones dropped past a limit in bytes.

    `cache[index]` returns the (H, W, 3) uint8 photo of `images[index]`; callers must not write into
    it. `prefetch` decodes ahead on background threads. Safe to use from several threads.
    """

    def __init__(
        self, images: Sequence[PosedImage], limit_bytes: int | None = None, threads: int = 2
    ) -> None:
        """Args: `limit_bytes`: for the photos kept; default a quarter of the machine's memory."""
        self._images = list(images)
        self._limit = machine_memory() // 4 if limit_bytes is None else limit_bytes
        self._kept: OrderedDict[int, Pixels] = OrderedDict()
        self._kept_bytes = 0
        self._pending: dict[int, Future[Pixels]] = {}
        self._lock = threading.Lock()
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="photos")
        self._closed = False

    def __len__(self) -> int:
        return len(self._images)

    @property
    def kept_bytes(self) -> int:
        """Bytes of the photos held now."""
        return self._kept_bytes

    def __getitem__(self, index: int) -> Pixels:
        """The photo, decoded now unless it is held or under way. Raises PhotoError as it does."""
        index = range(len(self._images))[index]
        with self._lock:
            if index in self._kept:
                self._kept.move_to_end(index)
                return self._kept[index]
            future = self._pending.get(index)
            mine = (
                future is None or future.cancel()
            )  # still queued: faster done here than waited for
            if mine:
                future = self._pending[index] = Future()
                future.set_running_or_notify_cancel()
        assert future is not None
        if mine:
            self._decode(index, future)
        return future.result()

    def prefetch(self, indices: Iterable[int]) -> None:
        """Decode these photos in the background, as far as they fit beside each other.

        A photo that cannot be decoded raises only when it is asked for.
        """
        planned = 0
        for given in indices:
            index = range(len(self._images))[given]
            camera = self._images[index].camera
            planned += 3 * camera.width * camera.height
            if planned > self._limit // 2:
                return
            with self._lock:
                if self._closed or index in self._pending:
                    continue
                if index in self._kept:
                    self._kept.move_to_end(index)
                    continue
                future: Future[Pixels] = Future()
                self._pending[index] = future
                self._pool.submit(self._decode_queued, index, future)

    def close(self) -> None:
        """Drop everything and end the threads; photos can still be read, one by one."""
        with self._lock:
            self._closed = True
            for future in self._pending.values():
                future.cancel()
            self._kept.clear()
            self._kept_bytes = 0
        self._pool.shutdown(wait=True, cancel_futures=True)

    def __enter__(self) -> PhotoCache:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def _decode_queued(self, index: int, future: Future[Pixels]) -> None:
        """On a background thread: `_decode`, unless the photo was asked for or closed meanwhile."""
        if future.set_running_or_notify_cancel():
            self._decode(index, future)

    def _decode(self, index: int, future: Future[Pixels]) -> None:
        """Fill the running `future` and keep the photo."""
        try:
            pixels = load_photo(self._images[index])
        except BaseException as error:  # handed to whoever waits for it
            with self._lock:
                self._forget(index, future)
            future.set_exception(error)
            return
        with self._lock:
            self._forget(index, future)
            if not self._closed:
                self._keep(index, pixels)
        future.set_result(pixels)

    def _forget(self, index: int, future: Future[Pixels]) -> None:
        if self._pending.get(index) is future:
            del self._pending[index]

    def _keep(self, index: int, pixels: Pixels) -> None:
        """Hold the photo as the most recent one; needs the lock."""
        if pixels.nbytes > self._limit or index in self._kept:
            return
        self._kept[index] = pixels
        self._kept_bytes += pixels.nbytes
        while self._kept_bytes > self._limit:
            _, dropped = self._kept.popitem(last=False)
            self._kept_bytes -= dropped.nbytes
