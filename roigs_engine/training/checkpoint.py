"""Checkpoints: the training state on disk, in a format that is fast and safe to load.

A file consists of:

    8 bytes     MAGIC
    8 bytes     length of the header, little-endian
    4 bytes     CRC-32 of the header
    header      JSON: the fingerprint, the state with each tensor replaced by its type and shape
    tensors     their bytes, in the order of the header
    4 bytes     CRC-32 of the tensors

Loading it cannot run code. Every length is checked before memory is allocated, and checksums detect
damage. The previous checkpoint is kept beside it and used if the last one is damaged.

A checksum detects damage, but not a file that another program wrote. The kernels trust their
tensors, so `check_state` checks these completely.
"""

from __future__ import annotations

import json
import math
import os
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import torch
from torch import Tensor

from ..context import QUIET, Context
from ..errors import RunFolderError
from ..formats.files import atomic_write, regular
from ..model.gaussians import NAMES
from .config import TrainConfig
from .state_reader import Shape, StateReader

MAGIC = b"ROIGSck3"
PREFIX = struct.Struct("<8sQI")
SUM = struct.Struct("<I")
TYPES = {
    str(dtype).removeprefix("torch."): dtype
    for dtype in (torch.float32, torch.float64, torch.int32, torch.int64, torch.uint8, torch.bool)
}
TENSOR = "<tensor>"  # key of a tensor's placeholder in the header
CHUNK = 1 << 20  # bytes per checksum update: small enough to stay in the processor's cache
MAX_HEADER = 1 << 20  # bytes; a header takes a few thousand
MAX_TENSORS = 1000
HEADER_ERRORS = (KeyError, TypeError, ValueError, OverflowError, RuntimeError)
"""Exceptions from a header with a valid checksum. RecursionError and torch's are RuntimeErrors."""
COLUMNS: dict[str, Shape] = {
    "means": (3,),
    "quats": (4,),
    "log_scales": (3,),
    "logit_opacities": (),
}
SH_SHAPES = [(bands, 3) for bands in (1, 4, 9, 16)]
MAX_SECONDS = 1e12
Check = Callable[[dict[str, Any]], None]
HINT = "Delete it to start the stage again, or choose another run folder."


class _DamagedError(Exception):
    """A file cannot be used; the text says why."""


def save_checkpoint(path: Path, state: dict[str, Any], fingerprint: str) -> None:
    """Write `state` to `path` atomically; the previous checkpoint becomes `NAME.before.bin`.

    The new file is not synced, so that a stop need not wait for the disk. A file is synced before
    it becomes the previous checkpoint, so one of the two survives a power failure.

    Args:
        path: the file.
        state: nested dicts of tensors, numbers and strings (`Trainer.state_dict`).
        fingerprint: of the stage's settings and inputs; checked when loading.

    Raises:
        RunFolderError: the folder is not writable, or the disk is full.
    """
    tensors: list[Tensor] = []
    record = {"fingerprint": fingerprint, "state": _described(state, tensors)}
    header = json.dumps(record).encode()
    with atomic_write(path, durable=False, before=_before(path)) as file:
        file.write(PREFIX.pack(MAGIC, len(header), zlib.crc32(header)))
        file.write(header)
        checksum = 0
        for chunk in _chunks(tensors):
            checksum = zlib.crc32(chunk, checksum)
            file.write(chunk)
        file.write(SUM.pack(checksum))


def load_checkpoint(
    path: Path, fingerprint: str, context: Context = QUIET, check: Check | None = None
) -> dict[str, Any]:
    """Load the last state that `save_checkpoint` wrote, or the previous one if it is damaged.

    Args:
        path, fingerprint: see `save_checkpoint`.
        context: receives a warning if the last one is damaged.
        check: raises ValueError if a state cannot be used; it then counts as damaged.

    Raises:
        RunFolderError: both are damaged or missing, or have another version or fingerprint.
    """
    problems = []
    for file in _present(path):
        try:
            header, state = _read(file)
            if header["fingerprint"] != fingerprint:
                raise RunFolderError(f"The checkpoint {file} has other settings.", HINT)
            if check is not None:
                check(state)
        except (ValueError, _DamagedError) as error:
            why = error if isinstance(error, _DamagedError) else f"is damaged ({error})"
            problems.append(f"The checkpoint {file} {why}.")
            continue
        for problem in problems:
            context.warn(f"{problem} Training resumes from the previous checkpoint.")
        return state
    raise RunFolderError(problems[0] if problems else f"There is no checkpoint {path}.", HINT)


def checkpoint_step(path: Path, fingerprint: str) -> int:
    """Return the step of the newest readable checkpoint with this fingerprint; 0 without one."""
    for name in _present(path):
        with (
            suppress(OSError, _DamagedError, *HEADER_ERRORS),
            open(name, "rb", opener=regular) as file,
        ):
            header = _header(file)
            if header["fingerprint"] == fingerprint:
                return max(0, int(header["state"]["step"]))
    return 0


def checkpoint_exists(path: Path) -> bool:
    """Whether there is a checkpoint, or a previous one."""
    return bool(_present(path))


def remove_checkpoint(path: Path) -> None:
    """Delete the checkpoint and the previous one."""
    for name in _present(path):
        name.unlink(missing_ok=True)


def _before(path: Path) -> Path:
    return path.with_suffix(f".before{path.suffix}")


def _present(path: Path) -> list[Path]:
    return [name for name in (path, _before(path)) if name.exists()]


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    try:
        with open(path, "rb", opener=regular) as file:
            header = _header(file)
            tensors: list[Tensor] = []
            left = os.fstat(file.fileno()).st_size - file.tell() - SUM.size
            state = _restored(header["state"], tensors, left)
            if sum(t.nbytes for t in tensors) != left:
                raise _DamagedError("has the wrong size")
            checksum = 0
            for chunk in _chunks(tensors):
                file.readinto(chunk)
                checksum = zlib.crc32(chunk, checksum)
            if SUM.unpack(file.read(SUM.size)) != (checksum,):
                raise _DamagedError("is damaged (wrong checksum)")
    except OSError as error:
        raise _DamagedError(f"cannot be read ({error.strerror})") from error
    except HEADER_ERRORS as error:
        raise _DamagedError("is damaged (malformed header)") from error
    return header, state


def _header(file: BinaryIO) -> dict[str, Any]:
    """Read the header of an open file; its checksum is verified before it is parsed."""
    prefix = file.read(PREFIX.size)
    if prefix[: len(MAGIC)] != MAGIC:
        raise _DamagedError("is damaged, or has another version")
    if len(prefix) < PREFIX.size:
        raise _DamagedError("is incomplete")
    _, length, checksum = PREFIX.unpack(prefix)
    if length > os.fstat(file.fileno()).st_size:
        raise _DamagedError("is incomplete")
    if length > MAX_HEADER:
        raise _DamagedError("is damaged (malformed header)")
    text = file.read(length)
    if zlib.crc32(text) != checksum:
        raise _DamagedError("is damaged (wrong header checksum)")
    try:
        header = json.loads(text)
        return {"fingerprint": str(header["fingerprint"]), "state": dict(header["state"])}
    except HEADER_ERRORS as error:
        raise _DamagedError("is damaged (malformed header)") from error


def _described(value: Any, tensors: list[Tensor]) -> Any:
    """Replace tensors in `value` by placeholders for JSON; append the tensors to the list."""
    if isinstance(value, Tensor):
        tensors.append(value.detach().cpu().contiguous())
        return {TENSOR: [str(value.dtype).removeprefix("torch."), list(value.shape)]}
    if isinstance(value, dict):
        return {key: _described(item, tensors) for key, item in value.items()}
    return value


def _restored(value: Any, tensors: list[Tensor], left: int) -> Any:
    """Invert `_described`; append the tensors, not filled yet, to the list.

    They are allocated only if they all fit into `left` bytes, the rest of the file.
    """
    if not isinstance(value, dict):
        return value
    if TENSOR in value:
        kind, shape = value[TENSOR]
        if not all(type(side) is int and side >= 0 for side in shape):
            raise ValueError("a shape that is none")
        if len(tensors) == MAX_TENSORS:
            raise ValueError("more tensors than training has")
        if sum(t.nbytes for t in tensors) + math.prod(shape) * TYPES[kind].itemsize > left:
            raise _DamagedError("has the wrong size")
        tensors.append(torch.empty(shape, dtype=TYPES[kind]))
        return tensors[-1]
    return {key: _restored(item, tensors, left) for key, item in value.items()}


def _chunks(tensors: list[Tensor]) -> Iterator[memoryview]:
    """Yield the memory of the tensors in pieces of at most `CHUNK` bytes."""
    for tensor in tensors:
        if tensor.numel():
            whole = tensor.view(-1).view(torch.uint8).numpy().data
            for start in range(0, len(whole), CHUNK):
                yield whole[start : start + CHUNK]


def check_state(state: Mapping[str, Any], config: TrainConfig) -> None:
    """Raise ValueError unless `Trainer.load_state_dict` can continue from the state."""
    whole = StateReader(state, config.steps)
    step = whole.count("step", config.steps)
    for key in ("seconds", "cpu_seconds"):
        if not 0 <= whole.number(key) <= MAX_SECONDS:
            raise ValueError(f"'{key}' is not a time")
    for key in ("loss", "psnr"):  # NaN before the first measurement
        whole.number(key)
    shapes = _shapes(state.get("parameters"))
    whole = StateReader(state, config.steps, step, shapes)
    whole.part("parameters").tensors(shapes, finite=True)
    optimizer = whole.part("optimizer")
    optimizer.count("step_count", config.steps)
    optimizer.count("skipped_rows", 1 << 62)
    optimizer.part("exp_avg").tensors(shapes)
    optimizer.part("exp_avg_sq").tensors(shapes, least=0.0)
    widths = {name: (math.prod(shape[1:]),) for name, shape in shapes.items()}
    optimizer.part("rates").tensors(widths, least=0.0, finite=True)
    acting = [each for each in config.mechanisms if each.acts(config)]
    mechanisms = whole.part("mechanisms")
    mechanisms.exactly(each.name for each in acting)
    for each in acting:
        each.check_state(mechanisms.part(each.name))


def _shapes(parameters: Any) -> dict[str, Shape]:
    """Return the shapes of the Gaussians' tensors by name; ValueError if they are not Gaussians."""
    values = parameters if isinstance(parameters, dict) else {}
    means, sh = values.get("means"), values.get("sh")
    if not (isinstance(means, Tensor) and means.ndim == 2 and len(means)):
        raise ValueError("it has no Gaussians")
    if not (isinstance(sh, Tensor) and tuple(sh.shape[1:]) in SH_SHAPES):
        raise ValueError("'sh' has a wrong shape")
    columns = {**COLUMNS, "sh": tuple(sh.shape[1:])}
    return {name: (len(means), *columns[name]) for name in NAMES}
