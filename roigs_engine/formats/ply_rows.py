"""PLY files: their header, and the rows of their vertices; numpy only.

Binary files of either byte order and ASCII are read. Headers and sizes are checked before memory is
allocated for what they promise.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import RunFolderError
from .contents import held_instead
from .files import UNREADABLE, regular

HINT = "Give a PLY of 3D Gaussians, as training programs write them."
HINT_DAMAGED = "Write or download the file again."
Check = Callable[[], None]
"""Called between the parts of long work; it raises `Stopped` if a stop was requested."""
ROWS, LINES = 1 << 18, 1 << 14  # Gaussians read at once: binary, ASCII
# Scalar types of a PLY -> numpy's.
SCALARS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4",
    "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
FORMS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
"""Format of a PLY -> byte order of the numbers."""
MAX_HEADER = 1 << 20  # bytes; some programs write all their settings into comments


def nothing() -> None:
    """Do nothing: the default `Check`."""


@dataclass(frozen=True, kw_only=True)
class Element:
    """An element of a PLY's header."""

    name: str
    count: int
    fields: dict[str, str]  # name -> type, without byte order; for a list, its values' type
    lists: dict[str, str]  # only fields that are lists: name -> type of the length


def vertex_rows(
    path: str | Path, check: Check, *, only_header: bool = False
) -> Iterator[NDArray[np.void]]:
    """Yield the vertices' rows in parts; with `only_header`, one part without rows.

    RunFolderError: the file is missing, truncated or damaged, or has no plain vertices.
    """
    try:
        with open(path, "rb", opener=regular) as file:
            form, elements = read_header(file, path)
            elements, order = _up_to_vertices(elements, path), FORMS[form]
            vertex = elements[-1]
            row = np.dtype([(name, order + kind) for name, kind in vertex.fields.items()])
            count = vertex.count
            if form == "ascii":
                _check_lines(file, elements, row, path, check)
            else:
                _skip(file, elements[:-1], order, path, check)
            # Check this before allocating memory: a damaged header may promise any number.
            there = max(os.fstat(file.fileno()).st_size - file.tell(), 0) // row.itemsize
            if form != "ascii" and there < count:
                raise _truncated(path, there, count)
            if only_header or not count:
                yield np.zeros(0, row)
            elif form == "ascii":
                yield from _text_rows(file, count, row, path, check)
            else:
                for start in range(0, count, ROWS):
                    rows = np.fromfile(file, row, min(ROWS, count - start))
                    if len(rows) < min(ROWS, count - start):  # truncated meanwhile
                        raise _truncated(path, start + len(rows), count)
                    yield rows
    except OSError as error:
        raise RunFolderError(f"Cannot read {path} ({error.strerror}).", UNREADABLE) from error


def _truncated(path: str | Path, there: int, count: int) -> RunFolderError:
    text = f"{path} is truncated: it has {there} of {count} Gaussians."
    return RunFolderError(text, HINT_DAMAGED)


def _skip(
    file: BinaryIO, elements: list[Element], order: str, path: str | Path, check: Check
) -> None:
    """Move `file` past the binary elements before the vertices."""
    size, big = os.fstat(file.fileno()).st_size, order == ">"
    for element in elements:
        columns = [
            (element.lists.get(name, ""), np.dtype(kind).itemsize)
            for name, kind in element.fields.items()
        ]
        if not element.lists:
            length = element.count * sum(width for _, width in columns)
            file.seek(min(file.tell() + length, size))
            continue
        places = (column for _ in range(element.count) for column in columns)
        for index, (kind, width) in enumerate(places):  # a row has at least one byte
            if not index % LINES:
                check()
            values, there = 1, True
            if kind:
                number = file.read(int(kind[1]))
                there = len(number) == int(kind[1])  # stops at the end of the file
                signed = kind[0] == "i"
                values = int.from_bytes(number, "big" if big else "little", signed=signed)
            if not there or values < 0 or file.seek(values * width, io.SEEK_CUR) > size:
                text = f"{path} is truncated: its element {element.name:.40} is cut off."
                raise RunFolderError(text, HINT_DAMAGED)


def _check_lines(
    file: BinaryIO,
    elements: list[Element],
    row: np.dtype[np.void],
    path: str | Path,
    check: Check,
) -> None:
    """Move `file` past the lines before the vertices; RunFolderError if it is too short."""
    count = elements[-1].count
    # The shortest line has a digit and a space or line break for each number.
    most = (os.fstat(file.fileno()).st_size - file.tell() + 1) // (2 * len(row.names or ()))
    if most < count:
        raise _truncated(path, most, count)
    for index in range(sum(element.count for element in elements[:-1])):
        if not index % LINES:
            check()
        if not _line(file, path):
            raise _truncated(path, 0, count)


def _text_rows(
    file: BinaryIO, count: int, row: np.dtype[np.void], path: str | Path, check: Check
) -> Iterator[NDArray[np.void]]:
    """Yield the vertices of an ASCII PLY, one a line, in parts."""
    names = row.names or ()
    lines = filter(bytes.strip, _lines(file, path, check))
    for start in range(0, count, LINES):
        part = [*islice(lines, min(LINES, count - start))]
        # Check this before allocating memory for so many numbers in every row.
        if part and (width := len(part[0].split())) != len(names):
            text = f"{path} is damaged: its Gaussians have {width} of {len(names)} numbers."
            raise RunFolderError(text, HINT_DAMAGED)
        if len(part) < min(LINES, count - start):
            raise _truncated(path, start + len(part), count)
        try:
            numbers = np.loadtxt(part, np.float64, comments=None, ndmin=2)
        except ValueError as error:
            text = (
                f"{path} is damaged: a line of its Gaussians has other than {len(names)} numbers."
            )
            raise RunFolderError(text, HINT_DAMAGED) from error
        table = np.empty(len(numbers), row)
        with np.errstate(over="ignore", invalid="ignore"):
            for index, name in enumerate(names):
                table[name] = numbers[:, index]
        yield table


def _lines(file: BinaryIO, path: str | Path, check: Check) -> Iterator[bytes]:
    """The lines of an ASCII PLY from here on, blank ones too."""
    for index, line in enumerate(iter(lambda: _line(file, path), b"")):
        if not index % LINES:
            check()
        yield line


def _line(file: BinaryIO, path: str | Path) -> bytes:
    """The next line of an ASCII PLY, empty at the end; RunFolderError: it is far too long."""
    line = file.readline(MAX_HEADER)
    if len(line) == MAX_HEADER:
        text = f"{path} is damaged: a line is longer than {MAX_HEADER >> 20} MB."
        raise RunFolderError(text, HINT_DAMAGED)
    return line


def header_lines(path: str | Path) -> list[bytes]:
    """Read the lines of a PLY's header, with single spaces between words.

    RunFolderError: the file cannot be read.
    """
    try:
        with open(path, "rb", opener=regular) as file:
            head = file.read(MAX_HEADER).partition(b"\nend_header")[0]
    except OSError as error:
        raise RunFolderError(f"Cannot read {path} ({error.strerror}).", UNREADABLE) from error
    return [b" ".join(line.split()) for line in head.splitlines()]


def read_header(file: BinaryIO, path: str | Path) -> tuple[str, list[Element]]:
    """Read a PLY's format and elements, up to its first row; RunFolderError: it is no PLY."""
    head = file.read(MAX_HEADER)
    end = re.search(rb"\nend_header\r?\n", head)
    if not re.match(rb"ply\r?\n", head) or (end is None and len(head) < MAX_HEADER):
        what, hint = held_instead(Path(path), head) or ("is not a PLY file", HINT)
        raise RunFolderError(f"{path} {what}.", hint)
    if end is None:
        text = f"{path}: the header of this PLY is longer than {MAX_HEADER >> 20} MB."
        raise RunFolderError(text, "Write it again with shorter comments.")
    file.seek(end.end())
    elements: list[Element] = []
    form = ""
    for line in head[: end.start()].decode("ascii", "replace").splitlines()[1:]:
        match line.split():
            case ["format", form, *_]:
                pass
            case ["element", name, number]:
                if not re.fullmatch("[0-9]{1,18}", number):
                    text = f"{path}: '{number:.20}' is not a number of vertices."
                    raise RunFolderError(text, HINT)
                elements.append(Element(name=name, count=int(number), fields={}, lists={}))
            case ["property", *words] if elements:
                _add_property(elements[-1], words, line, path)
    if form not in FORMS:
        raise RunFolderError(f"{path} is a PLY in the unknown format '{form:.60}'.", HINT)
    return form, elements


def _up_to_vertices(elements: list[Element], path: str | Path) -> list[Element]:
    """The elements up to and including the vertices; RunFolderError: they are no Gaussians."""
    place = [k for k, element in enumerate(elements) if element.name == "vertex"]
    if any(element.name == "chunk" for element in elements):
        raise RunFolderError(f"{path} is a compressed PLY.", "Save it uncompressed.")
    if not place or not elements[place[0]].fields:
        raise RunFolderError(f"{path} has no vertex element.", HINT)
    if len(place) > 1:
        raise RunFolderError(f"{path} has {len(place)} vertex elements, not one.", HINT)
    return elements[: place[0] + 1]


def _add_property(element: Element, words: list[str], line: str, path: str | Path) -> None:
    """Add a property line of the header to its element; vertices must not have lists."""
    match words:
        case [kind, name] if kind in SCALARS and name not in element.fields:
            element.fields[name] = SCALARS[kind]
        case ["list", length, kind, name] if (
            element.name != "vertex"
            and SCALARS.get(length, "f")[0] != "f"
            and kind in SCALARS
            and name not in element.fields
        ):
            element.fields[name] = SCALARS[kind]
            element.lists[name] = SCALARS[length]
        case _:
            raise RunFolderError(f"{path}: cannot read '{line.strip():.60}'.", HINT)
