"""Work that exchanges a model on disk, for processes of its own that are killed in the middle."""

from __future__ import annotations

from pathlib import Path

import pycolmap

from roigs_engine.colmap.refine import _write
from roigs_engine.context import QUIET
from roigs_engine.reconstruction.folder import Folder


def refined(model: Path, out: Path) -> None:
    """A refinement writes its model."""
    _write(pycolmap.Reconstruction(str(model)), out)


def grown(root: Path) -> None:
    """A second reconstruction takes its model in the place of the first."""
    folder = Folder(root)
    with folder.held(QUIET.warn):
        folder.take_model(folder.work("models", "more"))
        folder.finish("second")
