"""Finds the engine's last message of a kind in its log. No bpy."""

from __future__ import annotations

import re
from pathlib import Path

from ..errors import AddonError
from ..shared import EngineError, files


def last_said(log: Path, words: re.Pattern[str]) -> str:
    """Return the first group of the last line that matches; empty if none matches.

    Raises:
        AddonError: the log cannot be read.
    """
    try:
        lines = files.read_bytes(log).decode("utf-8", "replace").splitlines()
    except EngineError as error:
        raise AddonError(str(error)) from error
    found = [match[1] for line in lines if (match := words.fullmatch(line))]
    return found[-1] if found else ""
