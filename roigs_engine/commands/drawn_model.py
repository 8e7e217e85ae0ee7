"""Reads a PLY for pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ..formats.drawable import usable
from ..formats.splat_ply import is_antialiased, read_ply
from ..formats.text import counted

if TYPE_CHECKING:
    from ..model.gaussians import Gaussians
    from ..model.local_frame import LocalFrame


def drawn_model(path: Path, say: Callable[[str], None]) -> tuple[Gaussians, LocalFrame]:
    """The Gaussians of a PLY that can be drawn, in a frame of their own; returns both.

    Args:
        path: of the file.
        say: gets one line if some cannot be drawn.

    Raises:
        RunFolderError: the file is missing or damaged.
    """
    from ..model.gaussians import Gaussians

    stored = read_ply(path)
    arrays = usable(stored)
    there, kept = len(stored["means"]), len(arrays["means"])
    if kept < there:
        left_out = f"{there - kept:,} of {counted(there, 'Gaussian')}"
        say(f"{path}: {left_out} cannot be drawn (NaN, too large, or no rotation).")
    return Gaussians.framed(arrays, antialiased=is_antialiased(path))
