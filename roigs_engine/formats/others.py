"""Recognises files with our names that are not ours, by their content."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from ..errors import RunFolderError
from .files import LARGEST, regular, unlinked, write_bytes
from .text import parse_json

LINE = 1 << 16
"""Bytes of the first line of a log that are looked at."""
MARK, MARKED = b"Companion file by ROI-GS", 256
"""In the first bytes of files that the engine writes beside another, such as textures."""
PNG_HEADER = 33  # bytes up to the end of a PNG's first chunk


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

    RunFolderError: one of these names is taken by a file that is no companion of the engine's.
    """
    for name in files:
        refuse_other_companion(path, path.with_name(name))
    for name, data in files.items():
        write_bytes(path.with_name(name), marked(data))


def refuse_other_companion(path: Path, beside: Path) -> None:
    """Raise RunFolderError if `beside`, which `path` needs, is not a companion of the engine's."""
    if os.path.lexists(beside) and not _is_marked(beside):
        raise RunFolderError(
            f"{path} needs {beside.name} beside it, which would be replaced.",
            "Move that file, or choose another name.",
        )


def marked(data: bytes) -> bytes:
    """A PNG, a Radiance .hdr or a text (.mtl) with the mark of the engine's companion files."""
    if data.startswith(b"\x89PNG"):
        text = b"tEXtSoftware\0" + MARK
        chunk = struct.pack(">I", len(text) - 4) + text + struct.pack(">I", zlib.crc32(text))
        return data[:PNG_HEADER] + chunk + data[PNG_HEADER:]
    first = data.find(b"\n") + 1 if data.startswith(b"#?") else 0
    return data[:first] + b"# " + MARK + b"\n" + data[first:]


def _is_marked(path: Path) -> bool:
    with suppress(OSError), open(path, "rb", opener=unlinked) as file:
        return MARK in file.read(MARKED)
    return False
