"""Handles errors of writing into the user's folders, by the engine's rules for files. No bpy."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import AddonError
from ..shared import EngineError, files


@contextmanager
def writing(folder: Path, setting: str) -> Iterator[None]:
    """Wrap code that writes into a folder; `setting` is where the user chooses another one.

    Raises:
        AddonError: the folder cannot be created or written to.
    """
    try:
        yield
    except EngineError as error:
        raise AddonError(f"{error.message} Choose another {setting}.") from error
    except OSError as error:
        raise AddonError(
            f"{folder} cannot be created or written to ({error.strerror or error})."
            f" Choose another {setting}."
        ) from error


def made_folder(root: Path, *names: str) -> Path:
    """Return a folder in a run folder, created if it is missing.

    Raises:
        AddonError: it cannot be created, or is a link.
    """
    with writing(Path(root, *names), "Run Folder"):
        folder = files.own_folder(root, *names)
        folder.mkdir(parents=True, exist_ok=True)
    return folder
