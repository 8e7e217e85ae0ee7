"""Models for files and viewers that draw without anti-aliasing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from .console import Console
from .run_scene import cameras_of_result

if TYPE_CHECKING:
    from ..exchange.arrays import Arrays


def read_model(path: Path, *, plain: bool) -> tuple[Arrays, bool]:
    """The Gaussians of a file, and whether they are drawn with anti-aliasing.

    Args:
        path: of a file in any format that is read.
        plain: make them right without anti-aliasing, as far as the photos of the run that made the
            file tell how; if these are not known, they stay as they are.

    Raises:
        EngineError: as `formats.read`.
    """
    from ..exchange import formats
    from ..exchange.plain import without_antialiasing
    from ..model.gaussians import Gaussians

    arrays, antialiased = formats.read(path), formats.is_antialiased(path)
    scene = cameras_of_result(path) if antialiased and plain else None
    if scene is None:
        return arrays, antialiased
    model, frame = Gaussians.framed(arrays, antialiased=True)
    made = without_antialiasing(model, frame.scene(scene).images)
    return {**arrays, "logit_opacities": made.logit_opacities.numpy()}, False


def warn_of_antialiasing(title: str, console: Console) -> None:
    """Say that Gaussians are written as they are, where nobody draws them with anti-aliasing."""
    console.context.warn(
        f"{title}: other programs will show fine Gaussians too thick, as these are drawn with"
        " anti-aliasing. Convert the result in its run folder: its photos tell how to make up for"
        " it. Or write .spz, .sog or .html."
    )
