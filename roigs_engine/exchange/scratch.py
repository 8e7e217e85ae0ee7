"""A folder for the files of libraries that only write to names."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import EngineError
from ..machine import is_memory_full


@contextmanager
def scratch(title: str) -> Iterator[Path]:
    """A temporary folder, removed in the end; whatever fails meanwhile could not be written to it.

    Args:
        title: of the format, for the error.

    Raises:
        EngineError: there is no such folder, or the library could not write to it.
    """
    try:
        with tempfile.TemporaryDirectory() as folder:
            yield Path(folder)
    except (OSError, RuntimeError) as error:  # OpenUSD raises the latter
        if is_memory_full(error):
            raise
        raise EngineError(
            f"{title} cannot be written to the folder for temporary files, {_place()}.",
            "Free some space there, or set TMPDIR to another folder.",
        ) from error


def _place() -> str:
    try:
        return tempfile.gettempdir()
    except OSError:
        return "which does not exist"
