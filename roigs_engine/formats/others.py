"""Recognises files with our names that are not ours, by their content."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from ..errors import RunFolderError
from .files import LARGEST, read_bytes, regular, write_bytes
from .text import parse_json

LINE = 1 << 16
"""Bytes that are checked in the first line of a log."""


def is_other(path: Path, keys: Iterable[str], *, lines: bool = False) -> bool:
    """Whether `path` is taken by something that the engine did not write (`says_other`).

    Args:
        path: of a file; it need not exist.
        keys: that the engine's files of this kind have.
        lines: the engine's file has one JSON object a line; only the first line is checked.
    """
    try:
        with open(path, "rb", opener=regular) as file:
            return says_other(file.readline(LINE) if lines else file.read(LARGEST), keys)
    except FileNotFoundError:
        return False
    except OSError:  # a folder, a pipe, or an unreadable file
        return True


def says_other(data: bytes, keys: Iterable[str]) -> bool:
    """Whether a file's bytes are not the engine's: not a JSON object with these keys.

    False for an empty file, or one with only zeros: a crash of the computer leaves such files.
    """
    if not data.strip(b"\0 \r\n"):
        return False
    with suppress(ValueError):
        record = parse_json(data)
        return not (isinstance(record, dict) and set(keys) <= record.keys())
    return True


def first_other(folder: Path, files: Mapping[str, Iterable[str]]) -> Path | None:
    """The first of `files` (name -> the engine's keys) that another program wrote, or None."""
    paths = ((folder / name, keys) for name, keys in files.items())
    return next((path for path, keys in paths if is_other(path, keys)), None)


def write_beside(path: Path, files: Mapping[str, bytes]) -> None:
    """Write files (name -> content) beside `path`; the caller writes `path` after them.

    RunFolderError: `path` does not exist, but another file has one of these names.
    """
    for name, data in files.items() if not os.path.lexists(path) else ():
        beside = path.with_name(name)
        # The same content may be from a process that was killed before it wrote `path`.
        if os.path.lexists(beside) and not _has(beside, data):
            raise RunFolderError(
                f"{path} needs {beside.name} beside it, which would be replaced.",
                "Move that file, or choose another name.",
            )
    for name, data in files.items():
        write_bytes(path.with_name(name), data)


def _has(path: Path, data: bytes) -> bool:
    with suppress(OSError):
        return read_bytes(path, len(data)) == data
    return False
