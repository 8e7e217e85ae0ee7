"""Errors of libraries that read files become one line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from ..errors import EngineError, RunFolderError
from ..formats.text import in_gb

HINT = "Write or download the file again."
MOST_RATIO, SMALL = 100, 64 << 20
"""Files of Gaussians unpack to some ten times their size; bombs to a thousand times."""

OPENUSD = re.compile(r" at line \d+ in file .*? : '(.*?)\n?'(?:\n|$)", re.DOTALL)
"""Its errors begin with the place in its source."""


def damaged(path: Path, title: str, why: object) -> RunFolderError:
    """The error of a file that is not what its name says."""
    text = " ".join(str(why).split())[:120]
    return RunFolderError(f"{path} is not a whole {title} file ({text}).", HINT)


@contextmanager
def reading(path: Path, title: str) -> Iterator[None]:
    """Wrap a library that reads: whatever it raises says that the file is damaged.

    Raises:
        RunFolderError: it raised anything but an EngineError, an error of the file system or one of
            memory.
    """
    try:
        with np.errstate(all="ignore"):  # what is not finite is left out later
            yield
    except (EngineError, OSError, MemoryError, KeyboardInterrupt):
        raise
    except Exception as error:  # of struct, zlib, json, numpy, and of the libraries themselves
        raise damaged(path, title, _words(error)) from error


def _words(error: Exception) -> str:
    """What an error says, else its kind: OpenUSD's may quote bytes that are no text."""
    with suppress(UnicodeError):
        if text := str(error).strip():
            found = OPENUSD.search(text)
            return found[1] if found else text
    return type(error).__name__


def refuse_bomb(path: Path, title: str, unpacked: int) -> None:
    """Raise RunFolderError if a file would unpack to far more bytes than files of Gaussians do."""
    if unpacked > SMALL and unpacked > MOST_RATIO * path.stat().st_size:
        raise damaged(path, title, f"it would unpack to {in_gb(unpacked)}")
