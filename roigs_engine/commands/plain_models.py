"""Models for files and viewers that draw without anti-aliasing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import ConfigError
from .console import Console
from .run_scene import cameras_of_result

if TYPE_CHECKING:
    from ..exchange.arrays import Arrays
    from ..exchange.formats import FileFormat


def read_model(path: Path, *, plain: bool, scene: Path | None = None) -> tuple[Arrays, bool]:
    """The Gaussians of a file, and whether they are drawn with anti-aliasing.

    Args:
        path: of a file in any format that is read.
        plain: make them about right without anti-aliasing, as far as photos tell how; if these are
            not known, they stay as they are.
        scene: of the photos; None: that of the run that made the file.

    Raises:
        EngineError: as `formats.read`; `scene` cannot be used.
    """
    from ..exchange import formats
    from ..exchange.plain import without_antialiasing
    from ..model.gaussians import Gaussians

    arrays, antialiased = formats.read(path), formats.is_antialiased(path)
    photos = cameras_of_result(path, scene) if antialiased and plain else None
    if photos is None:
        return arrays, antialiased
    model, frame = Gaussians.framed(arrays, antialiased=True)
    made = without_antialiasing(model, frame.scene(photos).images)
    return {**arrays, "logit_opacities": made.logit_opacities.numpy()}, False


def photos_unknown(target: FileFormat, console: Console) -> None:
    """Refuse to write anti-aliased Gaussians as plain ones; warn where the format leaves no choice.

    Raises:
        ConfigError: the format can say how Gaussians are drawn.
    """
    why = "the photos that they were trained on are not known"
    if target.keeps_antialiased:
        raise ConfigError(
            f"--plain cannot change these Gaussians, as {why}.",
            "Give their scene's folder with --scene, or leave out --plain.",
        )
    console.context.warn(
        f"{target.title} cannot say that these Gaussians are anti-aliased, and {why}: other"
        " programs will show fine ones too thick. Give their scene's folder with --scene, or write"
        " .ply, .spz, .sog or .html."
    )
