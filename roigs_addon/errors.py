"""The one kind of error that the add-on raises on purpose."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class AddonError(Exception):
    """Something the user can put right; its text is one line that says how."""


@contextmanager
def writing(folder: Path, setting: str) -> Iterator[None]:
    """Around what writes into a folder; `setting`: what chooses another one.

    Raises:
        AddonError: it cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise AddonError(
            f"{folder} cannot be made or written ({error.strerror or error})."
            f" Choose another {setting}."
        ) from error
