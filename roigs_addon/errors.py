"""The one kind of error that the add-on raises on purpose."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class AddonError(Exception):
    """Something the user can fix; its text is one line that says how."""


@contextmanager
def writing(folder: Path, setting: str) -> Iterator[None]:
    """Wrap code that writes into a folder; `setting` is where the user chooses another one.

    Raises:
        AddonError: the folder cannot be created or written to.
    """
    try:
        yield
    except OSError as error:
        raise AddonError(
            f"{folder} cannot be created or written to ({error.strerror or error})."
            f" Choose another {setting}."
        ) from error
