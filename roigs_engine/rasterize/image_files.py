"""Writes rendered images: PNGs, layers for compositing, and images along a camera path."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from ..context import QUIET, Context
from ..errors import EngineError
from ..formats.events import Preview, StageStarted
from ..formats.files import atomic_write
from ..formats.frame_requests import colour_file, depth_file, index_file, png, share_file, tiff
from ..formats.names import safe_name
from ..formats.others import marked
from ..machine import package
from ..model.gaussians import Gaussians
from ..model.scene import Camera, Float64
from .camera_path import CameraPath
from .instances import Layer
from .mattes import ranked
from .view import render_view


def to_uint8(image: Tensor) -> NDArray[np.uint8]:
    """(H, W, 3) values in [0, 1] -> (H, W, 3) uint8, rounded to nearest."""
    return (image.detach().clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()


def save_png(path: Path, image: NDArray[np.uint8]) -> None:
    """Write (H, W, 3) uint8 as a PNG to `path`, atomically."""
    with atomic_write(path) as file:
        Image.fromarray(image).save(file, format="PNG")


def save_layer(out: Path, layer: Layer) -> None:
    """Write the files of an answer (docs/files.md), mattes if there are any; the picture last."""
    numbers = {depth_file(out): layer.depth}
    if layer.shares:
        numbers |= zip((index_file(out), share_file(out)), ranked(layer.shares), strict=True)
    for path, values in numbers.items():
        with atomic_write(path, durable=False) as file:
            file.write(tiff(values.numpy().astype(np.float32)))
    rgba = to_uint8(torch.cat([layer.image, layer.alpha[..., None]], dim=-1))
    height, width = rgba.shape[:2]
    rows = np.zeros((height, 1 + 4 * width), np.uint8)
    rows[:, 1:] = rgba.reshape(height, -1)
    with atomic_write(colour_file(out), durable=False) as file:
        file.write(png(rows.tobytes(), width, height))


def save_light(path: Path, light: NDArray[np.float32], *, companion: bool = False) -> None:
    """Write (H, W, 3) linear light as a Radiance .hdr to `path`, atomically.

    `companion`: with the mark of a file that belongs to another.
    EngineError: OpenCV is not installed, or has no space for a temporary file.
    """
    cv2: Any = package("cv2", "A panorama", "opencv-python-headless")
    done, data = cv2.imencode(".hdr", np.ascontiguousarray(light[..., ::-1], dtype=np.float32))
    if not done:  # OpenCV writes to its own temporary file first
        raise EngineError(
            f"{path} cannot be written to the folder for temporary files.",
            "Free some space there, or set TMPDIR to another folder.",
        )
    with atomic_write(path) as file:
        file.write(marked(data.tobytes()) if companion else data.tobytes())


def render_sequence(
    model: Gaussians | Callable[[Camera, Float64], Gaussians],
    cameras: CameraPath,
    out_dir: Path,
    context: Context = QUIET,
) -> list[Path]:
    """Render every camera to `out_dir/NAME.png` (8-bit sRGB); return the files in this order.

    `model` is the Gaussians, or a function that returns those for a camera and its world_to_camera.
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
