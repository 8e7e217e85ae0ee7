"""Errors of libraries that read files become one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import EngineError, RunFolderError

HINT = "Write or download the file again."


def damaged(path: Path, title: str, why: object) -> RunFolderError:
    """The error of a file that is not what its name says."""
    text = " ".join(str(why).split())[:120]
    return RunFolderError(f"{path} is not a whole {title} file ({text}).", HINT)


@contextmanager
def reading(path: Path, title: str) -> Iterator[None]:
    """Wrap a library that reads: whatever it raises says that the file is damaged.

    Raises:
        RunFolderError: it raised anything but an EngineError or an error of the file system.
    """
    try:
        yield
    except (EngineError, OSError, KeyboardInterrupt):
        raise
    except Exception as error:  # of struct, zlib, json, numpy, and of the libraries themselves
        raise damaged(path, title, error or type(error).__name__) from error
