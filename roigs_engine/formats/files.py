"""Writing files so that a name never stands for half a file."""

from __future__ import annotations

import errno
import json
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from ..errors import EngineError, RunFolderError
from .text import parse_json

UNREADABLE = "Check that the file exists and that you may read it."
DAMAGED = "Write the file again, or choose another."
LEFTOVER = re.compile(r"^\..+\.\d+\.part$")  # what `atomic_write` calls its temporary files


def regular(path: str, flags: int) -> int:
    """The `opener` of everything that is read: OSError for a pipe, a device or a socket.

    Opening one of these never waits.
    """
    descriptor = os.open(path, flags | getattr(os, "O_NONBLOCK", 0), 0o666)
    kind = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(kind):
        os.close(descriptor)
        is_folder = stat.S_ISDIR(kind)
        raise OSError(
            *((errno.EISDIR, "Is a directory") if is_folder else (errno.EINVAL, "Not a file")), path
        )
    return descriptor


def read_bytes(path: Path) -> bytes:
    """The content of a file; OSError if it cannot be read, or is not a regular file."""
    with open(path, "rb", opener=regular) as file:
        return file.read()


@contextmanager
def atomic_write(
    path: Path, *, durable: bool = True, before: Path | None = None
) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path`; rename it to `path` once the block ends well.

    What stood under `path` before is untouched until then, and stays when the block fails.

    Args:
        path: where the whole file shall be.
        durable: wait until the disk has it; otherwise a power cut some seconds later may damage it.
        before: what stood under `path` is kept under this name, and is durable by then.

    Raises:
        RunFolderError: the folder cannot be written to, or the disk is full.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(temporary, "wb") as file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        if before is not None and path.exists():
            with open(path, "r+b") as earlier:
                os.fsync(earlier.fileno())
            os.replace(path, before)
        os.replace(temporary, path)
    except OSError as error:
        raise RunFolderError(
            f"Cannot write {path} ({error.strerror or error}).",
            "Free some space or choose another folder.",
        ) from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def remove_leftovers(folder: Path) -> None:
    """Delete the temporary files that a killed process has left; nobody else may write there."""
    for path in folder.rglob(".*.part"):
        if LEFTOVER.search(path.name):
            with suppress(OSError):
                path.unlink()


def write_text(path: Path, text: str, *, durable: bool = True) -> None:
    """Write UTF-8 text under `path`, whole or not at all; `durable` as `atomic_write`."""
    with atomic_write(path, durable=durable) as file:
        # Names on disk that are no UTF-8 come with surrogates, written as JSON writes them.
        file.write(text.encode("utf-8", "backslashreplace"))


def write_json(path: Path, value: Any, *, durable: bool = True) -> None:
    """Write `value` as indented UTF-8 JSON under `path`, whole or not at all."""
    write_text(path, json.dumps(value, indent=1, ensure_ascii=False) + "\n", durable=durable)


def read_json(path: Path, kind: type[EngineError] = RunFolderError, hint: str = DAMAGED) -> Any:
    """The JSON value in `path`: UTF-8, with or without a byte order mark.

    Args:
        path: the file.
        kind: the error to raise.
        hint: what to do about a file that is not JSON.

    Raises:
        EngineError: of that `kind`: the file is missing, unreadable or not JSON.
    """
    try:
        return parse_json(read_bytes(path))
    except OSError as error:
        raise kind(f"Cannot read {path} ({error.strerror}).", UNREADABLE) from error
    except ValueError as error:
        raise kind(f"{path} is not JSON ({error}).", hint) from error
