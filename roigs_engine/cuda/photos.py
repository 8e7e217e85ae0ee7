"""Photos on the training device: kept there as bytes, or uploaded in advance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .device import SHARE_OF_PHOTOS, card_memory


class Photos(Protocol):
    """Decoded photos in main memory: the interface of `photos.cache.PhotoCache`."""

    def __getitem__(self, index: int) -> NDArray[np.uint8]: ...

    def prefetch(self, indices: Sequence[int]) -> None: ...


def photos_on(device: torch.device, photos: Photos, limit: int | None) -> HostPhotos | DevicePhotos:
    """The photos as tensors on the device, uint8: (H, W, 3), or with a mask (H, W, 4).

    `limit`: most bytes of a GPU for photos; None: a share of its free memory.
    """
    if device.type == "cpu":
        return HostPhotos(photos)
    if limit is None:
        limit = card_memory(device)[0] // SHARE_OF_PHOTOS
    return DevicePhotos(photos, _Uploads(device), limit)


class HostPhotos:
    """Photos in main memory, not copied."""

    def __init__(self, photos: Photos) -> None:
        self._photos = photos

    def __getitem__(self, index: int) -> Tensor:
        """The photo; decodes it now unless it was prefetched."""
        return torch.from_numpy(self._photos[index])

    def prefetch(self, indices: Sequence[int]) -> None:
        """Decode these in the background."""
        self._photos.prefetch(indices)


class DevicePhotos:
    """Photos on a device; a thread uploads them while the device computes.

    The first photos stay on the device, as many as fit into the limit; the others are uploaded for
    each use. In epochs over all photos, no cache of that size has a higher hit rate.
    """

    def __init__(
        self,
        photos: Photos,
        upload: Callable[[NDArray[np.uint8]], Callable[[], Tensor]],
        limit: int,
    ) -> None:
        """Args: `upload`: starts a copy, returns a function that waits for it; `limit`: bytes."""
        self._photos, self._upload, self._free = photos, upload, limit
        self._kept: dict[int, Tensor] = {}
        self._coming: dict[int, Future[Callable[[], Tensor]]] = {}
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="upload")

    def __getitem__(self, index: int) -> Tensor:
        """The photo; the CPU waits only if it has not been decoded yet."""
        if index in self._kept:
            return self._kept[index]
        coming = self._coming.pop(index, None)
        arrived = (self._send(index) if coming is None else coming.result())()
        if arrived.nbytes <= self._free:
            self._free -= arrived.nbytes
            self._kept[index] = arrived
        return arrived

    def prefetch(self, indices: Sequence[int]) -> None:
        """Decode and upload these in the background; errors are raised when a photo is used."""
        missing = [i for i in dict.fromkeys(indices) if i not in self._kept]
        self._photos.prefetch(missing)
        for index in missing:
            if index not in self._coming:
                self._coming[index] = self._pool.submit(self._send, index)

    def _send(self, index: int) -> Callable[[], Tensor]:
        return self._upload(self._photos[index])


class _Uploads:
    """Copies through pinned memory on a separate stream, in parallel to the computation."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._stream = torch.cuda.Stream(device)  # type: ignore[no-untyped-call]

    def __call__(self, pixels: NDArray[np.uint8]) -> Callable[[], Tensor]:
        pinned = torch.from_numpy(pixels).pin_memory()
        with torch.cuda.stream(self._stream):
            photo = pinned.to(self._device, non_blocking=True)
        arrived = self._stream.record_event()

        def wait() -> Tensor:
            # Only the GPU waits, not the CPU.
            now = torch.cuda.current_stream(self._device)
            now.wait_event(arrived)
            photo.record_stream(now)
            return photo

        return wait
