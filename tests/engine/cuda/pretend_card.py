"""A make-believe GPU: what would make the processor wait for a real one is written down.

Its tensors say that they are on the device `meta`, and hold another tensor, in main memory, which
everything is computed with. So numbers are right, and nothing gets from one device to the other
without being seen.
"""

from __future__ import annotations

import weakref
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

from roigs_engine.cuda.pair_buffers import Number, PairBuffers
from roigs_engine.cuda.photos import DevicePhotos, Photos
from roigs_engine.rasterize import rasterize
from roigs_engine.training import loop, losses, stage_data, trainer
from roigs_engine.training.losses import photo_loss

FAR = torch.device("meta")
WAITING = (
    *("_local_scalar_dense", "nonzero", "masked_select", "equal", "is_nonzero"),
    *("_unique2", "unique_consecutive", "unique_dim", "repeat_interleave", "bincount"),
)
"""What returns a number or a size that only the GPU knows; `index` by a mask does as well."""


class Far(Tensor):
    """A tensor of the card."""

    near: Tensor

    @staticmethod
    def __new__(cls, near: Tensor) -> Far:
        made: Far = torch.Tensor._make_wrapper_subclass(
            cls,
            near.shape,
            strides=near.stride(),
            storage_offset=near.storage_offset(),
            dtype=near.dtype,
            device=FAR,
        )
        made.near = near
        return made

    def storage_size(self) -> tuple[int, int]:
        """A key of the tensor's memory, and its bytes."""
        storage = self.near.untyped_storage()
        return storage.data_ptr(), storage.nbytes()

    __torch_function__ = torch._C._disabled_torch_function_impl

    def data_ptr(self) -> int:
        """Where the shim's kernels find it."""
        return self.near.data_ptr()

    def tolist(self) -> Any:
        """Seen as a copy."""
        return self.to("cpu").tolist()

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        raise AssertionError(f"{func.name()} outside of the card")


class PretendCard(TorchDispatchMode):
    """While it is entered, there is a card.

    Attributes:
        waits: the names of what waited for it.
        most: bytes of tensors on it, at most at a time.
    """

    def __init__(self) -> None:
        super().__init__()
        self.waits: list[str] = []
        self.most = self._held = 0
        self._users: Counter[int] = Counter()

    def _far(self, near: Tensor) -> Far:
        made = Far(near)
        place, size = made.storage_size()
        self._users[place] += 1
        if self._users[place] == 1:
            self._held += size
            self.most = max(self.most, self._held)
        weakref.finalize(made, self._dropped, place, size)
        return made

    def _dropped(self, place: int, size: int) -> None:
        self._users[place] -= 1
        if not self._users[place]:
            self._held -= size

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        given = dict(kwargs or {})
        tensors = [t for t in tree_leaves((args, given)) if isinstance(t, Tensor)]
        are_far = [isinstance(t, Far) for t in tensors]
        to_far = any(are_far)
        if given.get("device") is not None:
            to_far = torch.device(given["device"]) == FAR
            given["device"] = torch.device("cpu")
        name = func.name().removeprefix("aten::").partition(".")[0]
        self._watch(name, tensors, to_far, given)
        near = partial(tree_map, lambda x: x.near if isinstance(x, Far) else x)
        found = func(*near(args), **near(given))
        first = args[0] if args else None
        for same in (first, given.get("out")):
            if isinstance(same, Far) and found is same.near:
                return same
        return tree_map(lambda x: self._far(x) if to_far and isinstance(x, Tensor) else x, found)

    def _watch(self, name: str, tensors: list[Tensor], to_far: bool, given: dict[str, Any]) -> None:
        far = [isinstance(t, Far) for t in tensors]
        if name in ("_to_copy", "copy_"):
            source = tensors[-1]
            is_queued = given.get("non_blocking") or (name == "copy_" and not far)
            pinned = isinstance(source, Far) or hasattr(source, "pinned")
            if isinstance(source, Far) != to_far or len(set(far)) > 1:
                self._wait(f"copy {tuple(source.shape)}", not (is_queued and pinned))
            return
        self._wait(name, any(far) and name in WAITING)
        if name in ("index", "index_put_", "index_put"):
            masks = [t for t in tensors[1:] if t.dtype == torch.bool and isinstance(t, Far)]
            self._wait(f"{name} by a mask", far[0] and bool(masks) and name != "index_put_")
            self._wait(f"{name} by a mask", name == "index_put_" and tensors[1].dtype == torch.bool)
        if any(far):  # as on a card: only scalars may be elsewhere
            assert all(f or t.dim() == 0 for f, t in zip(far, tensors, strict=True)), name

    def _wait(self, what: str, is_so: bool) -> None:
        if is_so:
            self.waits.append(what)

    def arriving(self, late: int) -> Callable[[Tensor], Number]:
        """A reader of numbers that arrive when `late` others were sent after them."""
        sent = 0

        def read(value: Tensor) -> Number:
            nonlocal sent
            assert isinstance(value, Far)
            sent += 1
            number, mine = int(value.near), sent

            def ask(wait: bool) -> int | None:
                is_there = sent >= mine + late
                self._wait("a view's pairs", wait and not is_there)
                return number if wait or is_there else None

            return ask

        return read


def use(
    patch: pytest.MonkeyPatch, card: PretendCard, *, buffers: bool = True, late: int = 2
) -> None:
    """Let a `Trainer` train on the card with our kernels, which the shim runs."""
    for name, function in (("rasterize", rasterize), ("photo_loss", photo_loss)):
        patch.setattr(trainer, name, partial(function, backend="cuda"))
    patch.setattr(losses, "photo_loss", trainer.photo_loss)  # of mechanisms
    patch.setattr(Tensor, "pin_memory", _pinned)
    tensor, new_tensor = torch.tensor, Tensor.new_tensor

    def made(values: Any, *, device: Any = None, **options: Any) -> Tensor:
        near = tensor(values, **options)
        return near if device is None else near.to(device)

    patch.setattr(torch, "tensor", made)
    patch.setattr(
        Tensor,
        "new_tensor",
        lambda self, values: (
            made(values, dtype=self.dtype, device=self.device)
            if isinstance(self, Far)
            else new_tensor(self, values)
        ),
    )

    def photos_on(device: torch.device, photos: Photos, limit: int | None) -> DevicePhotos:
        return DevicePhotos(photos, upload, 1 << 40)

    patch.setattr(stage_data, "photos_on", photos_on)
    made_buffers = (
        (lambda device: PairBuffers(device, card.arriving(late))) if buffers else lambda _: None
    )
    patch.setattr(loop, "pair_buffers_on", made_buffers)


def upload(pixels: NDArray[np.uint8]) -> Callable[[], Tensor]:
    """Another thread does it, where nothing is watched; the GPU waits, not the processor."""
    return lambda: torch.from_numpy(pixels).pin_memory().to(FAR, non_blocking=True)


def _pinned(tensor: Tensor) -> Tensor:
    copy: Any = tensor.clone()
    copy.pinned = True
    return copy  # type: ignore[no-any-return]
