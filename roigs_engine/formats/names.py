"""Portable file names, for every system."""

from __future__ import annotations

import hashlib
import os
import re
import unicodedata
from collections.abc import Iterable
from pathlib import PurePosixPath, PureWindowsPath

MAX_NAME = 100  # characters; endings are added to it
LONGEST, MAX_BYTES = 87, 167  # characters and bytes of a `safe_name`; file systems allow 255 bytes
LONG = 255  # characters of one path component, on any file system
ADDED = 8  # characters of the prefix `_` and of `-` with the checksum
WINDOWS = os.name == "nt"
# These names open devices on Windows, with any extension.
DEVICES = {
    *("con", "prn", "aux", "nul", "conin$", "conout$"),
    *(f"{port}{digit}" for port in ("com", "lpt") for digit in "0123456789¹²³"),
}


def safe_name(name: str) -> str:
    """`name` as one path component: letters of any script, digits, `-`, `.`, `_` and spaces.

    A name that had to be changed gets a short checksum, so that two names stay two files.
    """
    clean = re.sub(r"[^\w\-. ]+", "_", name).strip(" .")
    fits = len(clean) <= LONGEST and len(clean.encode()) <= MAX_BYTES
    if clean and clean == name and fits and not _is_device(name):
        return name
    clean = clean[: LONGEST - ADDED].encode()[: MAX_BYTES - ADDED].decode(errors="ignore")
    clean = clean.rstrip(" .") or "unnamed"
    clean = f"_{clean}" if _is_device(clean) else clean
    return f"{clean}-{hashlib.sha1(name.encode('utf-8', 'backslashreplace')).hexdigest()[:6]}"


def inner_path(name: object) -> PurePosixPath | None:
    """Convert a name from a file to a path in a folder; None if it is invalid or leads out.

    The name must be valid under the rules of both POSIX and Windows, where a path may begin with a
    drive. On Windows, device names are invalid, too.
    """
    if not isinstance(name, str) or "\0" in name or not _is_encodable(name):
        return None
    path, windows = PurePosixPath(name), PureWindowsPath(name)
    leads_out = path.is_absolute() or windows.drive or windows.root or ".." in windows.parts
    if WINDOWS and any(map(_is_device, windows.parts)):
        return None
    return None if leads_out or not path.parts else path


def usable_path(name: object) -> str:
    """Check a path from a file; it may be in any folder. ValueError: no system allows it."""
    if not isinstance(name, str) or "\0" in name or not _is_encodable(name):
        raise ValueError(f"{name!a:.60} is not a path")
    return name


def _is_encodable(name: str) -> bool:
    """Whether a file system can have the name; none has half of a surrogate pair."""
    try:
        return bool(name.encode("utf-8", "surrogateescape"))
    except UnicodeEncodeError:
        return False


def is_file_name(name: str) -> bool:
    """Whether every system allows files of that name."""
    return (
        0 < len(name) <= MAX_NAME
        and name == name.strip()
        and not name.endswith(".")
        and not any(c in '/\\:*?"<>|' or unicodedata.category(c) in ("Cc", "Cs") for c in name)
        and len(name.encode("utf-8", "replace")) <= 2 * MAX_NAME
        and not _is_device(name)
    )


def _is_device(name: str) -> bool:
    return name.partition(".")[0].strip().casefold() in DEVICES


def same_name(name: str) -> str:
    """A key that is equal for names that differ only in case, slashes or the form of accents."""
    return _composed(name.replace("\\", "/")).casefold()


def _composed(name: str) -> str:
    """The name with its accents in one form (NFC).

    The time is quadratic in the number of marks in a row, so longer parts are left unchanged. No
    file system has them.
    """
    parts = name.split("/")
    return "/".join(unicodedata.normalize("NFC", p) if len(p) <= LONG else p for p in parts)


def first_taken(names: Iterable[str]) -> str | None:
    """The first name that repeats an earlier one, ignoring case: their files would collide."""
    seen: set[str] = set()
    for name in names:
        key = _composed(name).casefold()
        if key in seen:
            return name
        seen.add(key)
    return None
