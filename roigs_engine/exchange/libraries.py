"""Guards around the optional libraries that read and write files of Gaussians.

A missing library, a damaged file and a full folder for temporary files become one line each.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from ..errors import EngineError, RunFolderError, Stopped
from ..formats.contents import FIRST_BYTES, held_instead
from ..formats.files import read_bytes, regular
from ..formats.names import inner_path
from ..formats.scratch import scratch as temporary
from ..formats.text import in_gb
from ..machine import is_memory_full


class NotSupportedError(Exception):
    """A valid file has a feature that is not supported; the text is a noun phrase that names it."""


HINT = "Write or download the file again."
CONVERT = "Save it as .ply with its original program, or with SuperSplat."
MOST_RATIO, SMALL = 100, 64 << 20
"""Files of Gaussians unpack to some ten times their size, zip bombs to a thousand times."""
MOST_PARTS = 4096  # of a file; each takes some milliseconds
MOST_WORDS = 4000
"""Letters of an error that are used; it may quote the file."""
OPENUSD = re.compile(r" at line \d+ in file .*? : '(.*?)\n?'(?:\n|$)", re.DOTALL)
"""OpenUSD's errors begin with the place in its source."""


@contextmanager
def reading(path: Path, title: str) -> Iterator[None]:
    """Turn any error of the block, which reads a file, into a RunFolderError of one line.

    A NotSupportedError says that the file is valid. An EngineError, an error of memory and a
    stop stay as they are.
    """
    try:
        # Libraries would wait for a pipe, and have their own errors for a missing file.
        with open(path, "rb", opener=regular):
            pass
        with np.errstate(all="ignore"):  # numbers that are not finite are left out later
            yield
    except (EngineError, MemoryError, Stopped):
        raise
    except NotSupportedError as error:
        raise RunFolderError(f"{path}: {error} is not supported.", CONVERT) from error
    except Exception as error:  # from struct, zlib, json, numpy, and the libraries themselves
        if isinstance(error, OSError) and error.errno is not None:  # Pillow's have none
            raise RunFolderError(
                f"Cannot read {path} ({error.strerror or error}).", "Check the file and its rights."
            ) from error
        text, held = " ".join(_words(error).split())[:120], None
        with suppress(OSError), open(path, "rb", opener=regular) as file:
            held = held_instead(path, file.read(FIRST_BYTES))
        if held is not None:
            raise RunFolderError(f"{path} {held[0]}.", held[1]) from error
        raise RunFolderError(f"{path} is not a whole {title} file ({text}).", HINT) from error


def _words(error: Exception) -> str:
    """Return an error's message, or its type's name: OpenUSD may quote bytes that are no text."""
    with suppress(UnicodeError):
        if text := str(error).strip()[:MOST_WORDS]:
            found = OPENUSD.search(text)
            return found[1] if found else text
    return type(error).__name__


def refuse_bomb(size: int, unpacked: int) -> None:
    """Raise ValueError if `size` bytes unpack to far more than those of Gaussians would."""
    if unpacked > SMALL and unpacked > MOST_RATIO * size:
        raise ValueError(f"it would unpack to {in_gb(unpacked)}")


def read_beside(path: Path, name: object) -> bytes:
    """Return the content of a file that `path` names, in its folder or below.

    RunFolderError if the name leads out of the folder, or the file cannot be read.
    """
    inner = inner_path(name)
    if inner is None:
        raise RunFolderError(
            f"{path} names the file {name!a:.60}, which is not below its folder.",
            "Keep all files of the model in one folder.",
        )
    try:
        return read_bytes(path.parent / inner, most=None)
    except OSError as error:
        raise RunFolderError(
            f"{path} needs {inner}, which cannot be read ({error.strerror or error}).",
            "Keep all files of the model in one folder.",
        ) from error


@contextmanager
def scratch(title: str) -> Iterator[Path]:
    """Yield a temporary folder to write a file of this format in; it is removed at the end.

    EngineError if it cannot be made, or if the library cannot write to it.
    """
    try:
        with temporary(f"roigs-{title.lower()}-") as folder:
            yield folder
    except (OSError, RuntimeError) as error:  # OpenUSD raises the latter
        if is_memory_full(error):
            raise
        try:
            place = tempfile.gettempdir()
        except OSError:
            place = "which does not exist"
        raise EngineError(
            f"{title} cannot be written to the folder for temporary files, {place}.",
            "Free some space there, or set TMPDIR to another folder.",
        ) from error
