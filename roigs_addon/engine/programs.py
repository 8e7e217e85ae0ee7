"""Finds programs on the computer, never in the working folder. No bpy."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path


def find_program(name: str, folders: Iterable[str] = ()) -> Path | None:
    """Return the program of this name in the folders of PATH or in others; None if not found.

    Unlike `shutil.which`, this ignores the working folder on Windows, and relative entries of PATH.
    They may be the folder of an untrusted .blend.

    Args:
        name: without `.exe`.
        folders: more folders to search.
    """
    file = f"{name}.exe" if os.name == "nt" else name
    for folder in _full([*os.environ.get("PATH", "").split(os.pathsep), *folders]):
        path = folder / file
        if path.is_file() and os.access(path, os.X_OK):
            return path
    return None


def windows_tool(name: str) -> str:
    """Return the path of a program that is part of Windows."""
    windows = Path(os.environ.get("SYSTEMROOT", r"C:\Windows"))
    return str(windows / "System32" / f"{name}.exe")


def _full(folders: Iterable[str]) -> Iterator[Path]:
    return (path for path in map(Path, folders) if path.is_absolute())
