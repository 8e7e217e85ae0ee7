"""Training state on disk: tensors and plain numbers, in a format of our own that is quick and safe.

A file holds, one after the other:

    8 bytes     MAGIC
    8 bytes     length of the header, little-endian
    4 bytes     CRC-32 of the header
    header      JSON: the fingerprint, the state with each tensor replaced by its type and shape
    tensors     their bytes, in the order in which the header names them
    4 bytes     CRC-32 of the tensors

Nothing in it can run code, every length is checked before memory is asked for, and a changed byte
is noticed. The checkpoint before the last is kept beside it and used when the last is damaged.
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import torch
from torch import Tensor

from ..context import QUIET, Context
from ..errors import RunFolderError
from ..formats.files import atomic_write

MAGIC = b"ROIGSck2"
PREFIX = struct.Struct("<8sQI")
SUM = struct.Struct("<I")
TYPES = {
    str(dtype).removeprefix("torch."): dtype
    for dtype in (torch.float32, torch.float64, torch.int32, torch.int64, torch.uint8, torch.bool)
}
TENSOR = "<tensor>"  # key of a header's stand-in for a tensor
CHUNK = 1 << 20  # bytes that are summed up while they are still in the processor's cache
HINT = "Delete it to begin the stage anew, or choose another run folder."


class _DamagedError(Exception):
    """Why a file cannot be used."""


def save_checkpoint(path: Path, state: dict[str, Any], fingerprint: str) -> None:
    """Write `state` under `path`, whole or not at all; what was there is kept as `NAME.before.bin`.

    What is written reaches the disk when the system sees fit, some seconds later, so that a stop
    need not wait for it. Before it becomes the one before, it is made sure of: of the two, one
    survives a power cut too.

    Args:
        path: the file.
        state: nested dicts of tensors, numbers and strings (`Trainer.state_dict`).
        fingerprint: of the stage's settings and inputs; checked when loading.

    Raises:
        RunFolderError: the folder cannot be written to, or the disk is full.
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


def load_checkpoint(path: Path, fingerprint: str, context: Context = QUIET) -> dict[str, Any]:
    """The state that `save_checkpoint` wrote last; the one before it when that is damaged.

    Raises:
        RunFolderError: both are damaged or missing, or belong to another version or stage.
    """
    problems = []
    for file in _present(path):
        try:
            header, state = _read(file)
        except _DamagedError as error:
            problems.append(f"The checkpoint {file} {error}.")
            continue
        if header["fingerprint"] != fingerprint:
            raise RunFolderError(f"The checkpoint {file} belongs to other settings.", HINT)
        for problem in problems:
            text = f"{problem} Training goes on from the one before it."
            context.warn(text)
        return state
    raise _unusable(path, problems)


def checkpoint_fingerprint(path: Path) -> str:
    """The fingerprint in a checkpoint; its tensors stay on disk. RunFolderError as loading."""
    problems = []
    for name in _present(path):
        try:
            with open(name, "rb") as file:
                return str(_header(file)["fingerprint"])
        except (OSError, _DamagedError) as error:
            problems.append(f"The checkpoint {name} {_because(error)}.")
    raise _unusable(path, problems)


def checkpoint_exists(path: Path) -> bool:
    """Whether there is one, or the one before it."""
    return bool(_present(path))


def remove_checkpoint(path: Path) -> None:
    """Delete it and the one before it."""
    for name in _present(path):
        name.unlink(missing_ok=True)


def _before(path: Path) -> Path:
    return path.with_suffix(f".before{path.suffix}")


def _present(path: Path) -> list[Path]:
    """The files that are there, newest first."""
    return [name for name in (path, _before(path)) if name.exists()]


def _unusable(path: Path, problems: list[str]) -> RunFolderError:
    return RunFolderError(problems[0] if problems else f"There is no checkpoint {path}.", HINT)


def _because(error: Exception) -> str:
    return f"cannot be read ({error.strerror})" if isinstance(error, OSError) else str(error)


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Header and state of a file."""
    try:
        with open(path, "rb") as file:
            header = _header(file)
            tensors: list[Tensor] = []
            state = _restored(header["state"], tensors)
            wanted = sum(t.nbytes for t in tensors) + SUM.size
            if os.fstat(file.fileno()).st_size - file.tell() != wanted:
                raise _DamagedError("is cut short")
            checksum = 0
            for chunk in _chunks(tensors):
                file.readinto(chunk)
                checksum = zlib.crc32(chunk, checksum)
            if SUM.unpack(file.read(SUM.size)) != (checksum,):
                raise _DamagedError("is damaged (its checksum does not fit)")
    except OSError as error:
        raise _DamagedError(_because(error)) from error
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise _DamagedError("is damaged (its header makes no sense)") from error
    return header, state


def _header(file: BinaryIO) -> dict[str, Any]:
    """The header of an open file, its checksum compared before anything in it is believed."""
    prefix = file.read(PREFIX.size)
    if prefix[: len(MAGIC)] != MAGIC:
        raise _DamagedError("is damaged, or of another version")
    if len(prefix) < PREFIX.size:
        raise _DamagedError("is cut short")
    _, length, checksum = PREFIX.unpack(prefix)
    if length > os.fstat(file.fileno()).st_size:
        raise _DamagedError("is cut short")
    text = file.read(length)
    if zlib.crc32(text) != checksum:
        raise _DamagedError("is damaged (its header's checksum does not fit)")
    try:
        header = json.loads(text)
        return {"fingerprint": str(header["fingerprint"]), "state": dict(header["state"])}
    except (KeyError, TypeError, ValueError) as error:
        raise _DamagedError("is damaged (its header makes no sense)") from error


def _described(value: Any, tensors: list[Tensor]) -> Any:
    """`value` as JSON; its tensors are appended to the list."""
    if isinstance(value, Tensor):
        tensors.append(value.detach().cpu().contiguous())
        return {TENSOR: [str(value.dtype).removeprefix("torch."), list(value.shape)]}
    if isinstance(value, dict):
        return {key: _described(item, tensors) for key, item in value.items()}
    return value


def _restored(value: Any, tensors: list[Tensor]) -> Any:
    """What `_described` was given, its tensors not yet filled; they are appended to the list."""
    if not isinstance(value, dict):
        return value
    if TENSOR in value:
        kind, shape = value[TENSOR]
        tensors.append(torch.empty(shape, dtype=TYPES[kind]))
        return tensors[-1]
    return {key: _restored(item, tensors) for key, item in value.items()}


def _chunks(tensors: list[Tensor]) -> Iterator[memoryview]:
    """The memory of the tensors, piece by piece."""
    for tensor in tensors:
        if tensor.numel():
            whole = tensor.view(-1).view(torch.uint8).numpy().data
            for start in range(0, len(whole), CHUNK):
                yield whole[start : start + CHUNK]
