"""Bounded cache of decoded photos."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from ..machine import machine_memory
from ..model.scene import PosedImage
from .decode import Pixels
from .mask_images import load_masked

THREADS = 2  # for decoding ahead


class PhotoCache:
    """Decoded photos of a scene; above a limit in bytes, drops the least recently used ones.

    `cache[index]` returns the photo of `images[index]`, (H, W, 3) uint8, or with its mask (H, W, 4)
    (`load_masked`); callers must not modify it. `prefetch` decodes ahead on background threads.
    Thread-safe.
    """

    def __init__(self, images: Sequence[PosedImage], limit_bytes: int | None = None) -> None:
        """Args: `limit_bytes`: for all kept photos; default: a quarter of the machine's memory."""
        self._images = list(images)
        self._limit = machine_memory() // 4 if limit_bytes is None else limit_bytes
        self._kept: OrderedDict[int, Pixels] = OrderedDict()
        self._kept_bytes = 0
        self._pending: dict[int, Future[Pixels]] = {}
        self._lock = threading.Lock()
        self._pool = ThreadPoolExecutor(THREADS, thread_name_prefix="photos")
        self._closed = False

    def __len__(self) -> int:
        return len(self._images)

    @property
    def kept_bytes(self) -> int:
        """Bytes of the photos in the cache."""
        return self._kept_bytes

    def __getitem__(self, index: int) -> Pixels:
        """The photo, decoded now unless it is cached or being decoded; raises PhotoError."""
        index = range(len(self._images))[index]
        with self._lock:
            if index in self._kept:
                self._kept.move_to_end(index)
                return self._kept[index]
            future = self._pending.get(index)
            # If it is still queued, decoding it here is faster than waiting.
            mine = future is None or future.cancel()
            if mine:
                future = self._pending[index] = Future()
                future.set_running_or_notify_cancel()
        assert future is not None
        if mine:
            self._decode(index, future)
        return future.result()

    def prefetch(self, indices: Iterable[int]) -> None:
        """Decode these photos in the background, as many as fit into half of the limit.

        A photo that cannot be decoded raises its error only when it is requested.
        """
        planned = 0
        for given in indices:
            index = range(len(self._images))[given]
            planned += self._images[index].decoded_bytes
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
        """Drop all photos and end the threads; photos can still be read one at a time."""
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
        """Call `_decode` on a background thread, unless another thread has taken the photo."""
        if future.set_running_or_notify_cancel():
            self._decode(index, future)

    def _decode(self, index: int, future: Future[Pixels]) -> None:
        """Decode the photo, set the result of the running `future`, and cache the photo."""
        try:
            pixels = load_masked(self._images[index])
        except BaseException as error:  # reading the future raises it
            with self._lock:
                self._forget(index, future)
            future.set_exception(error)
            return
        with self._lock:
            self._forget(index, future)
            if not self._closed and pixels.nbytes <= self._limit and index not in self._kept:
                self._kept[index] = pixels
                self._kept_bytes += pixels.nbytes
            while self._kept_bytes > self._limit:
                _, dropped = self._kept.popitem(last=False)
                self._kept_bytes -= dropped.nbytes
        future.set_result(pixels)

    def _forget(self, index: int, future: Future[Pixels]) -> None:
        if self._pending.get(index) is future:
            del self._pending[index]
