"""Renders every camera of a path to a PNG."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from ..context import QUIET, Context
from ..formats.events import Preview, StageStarted
from ..formats.names import safe_name
from ..model.gaussians import Gaussians
from ..model.scene import Camera, Float64
from .camera_path import CameraPath
from .image_files import save_png, to_uint8
from .view import render_view


def render_sequence(
    model: Gaussians | Callable[[Camera, Float64], Gaussians],
    cameras: CameraPath,
    out_dir: Path,
    context: Context = QUIET,
) -> list[Path]:
    """Render every camera to `out_dir/NAME.png` (8-bit sRGB); returns the files in this order.

    Args:
        model: the Gaussians, or those that a camera with this world_to_camera needs.
        cameras, out_dir, context: from where, and where to.
    """
    context.emit(StageStarted(stage="render", total=len(cameras)))
    started = time.monotonic()
    written: list[Path] = []
    for name, camera, world_to_camera in cameras:
        context.check_cancelled()
        gaussians = model if isinstance(model, Gaussians) else model(camera, world_to_camera)
        path = Path(out_dir) / f"{safe_name(name)}.png"
        save_png(path, to_uint8(render_view(gaussians, camera, world_to_camera).image))
        context.emit(Preview(path=str(path)))
        written.append(path)
        done, count = len(written), len(gaussians)
        context.progress("render", done, len(cameras), started, gaussians=count)
    return written
