"""Pictures of a model: one view, or every camera of a path file.

Camera path file (UTF-8 JSON, OpenCV axes, pixels and world units, docs/conventions.md):

    {"cameras": [{"name": "0001", "width": 960, "height": 540, "fx": 800.0, "fy": 800.0,
                  "cx": 480.0, "cy": 270.0, "world_to_camera": [[...4], [...4], [...4], [...4]]}]}

`world_to_camera` is a rotation and a translation; names are unique and become file names.
"""

from __future__ import annotations

import hashlib
import json
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from .cuda.memory import memory_explained, smaller
from .errors import ConfigError
from .events import Check, Emit, Preview, StageStarted, go_on, ignore, step_done
from .files import atomic_write
from .gaussians import Gaussians
from .rasterize import RenderOutput, rasterize
from .scene import Camera, Float64

CameraPath = Sequence[tuple[str, Camera, Float64]]
MAX_SIDE = 16384  # pixels; a larger width or height in a path file is a mistake


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderedView:
    """One picture.

    Attributes:
        image: (H, W, 3) float32 sRGB values in [0, 1].
        depth: (H, W) expected depth along the camera's z axis, world units, 0 where nothing is;
            None unless asked for.
    """

    image: Tensor
    depth: Tensor | None


@torch.no_grad()
def render_view(
    gaussians: Gaussians,
    camera: Camera,
    world_to_camera: Float64,  # (4, 4)
    *,
    with_depth: bool = False,
    background: Tensor | None = None,  # (3,)
) -> RenderedView:
    """Render the model from one camera, on the model's device, without gradients."""
    size = camera.width, camera.height

    def doing() -> str:
        return f"drawing {len(gaussians):,} Gaussians at {size[0]}x{size[1]}"

    def advice() -> str:
        return f"Draw smaller pictures (--max-side {smaller(*size)}), or use --device cpu."

    with memory_explained(doing, advice):
        output = rasterize_view(
            gaussians, camera, world_to_camera, background=background, with_depth=with_depth
        )
    depth = output.depth[0] if with_depth and output.depth is not None else None
    return RenderedView(image=output.image[0].clamp(0, 1), depth=depth)


def rasterize_view(
    gaussians: Gaussians, camera: Camera, world_to_camera: Float64, **options: Any
) -> RenderOutput:
    """`rasterize` of a model from one camera, (4, 4) world_to_camera, on the model's device.

    Args: `options`: of `rasterize`.
    """
    device = gaussians.means.device
    viewmat = torch.as_tensor(np.asarray(world_to_camera), dtype=torch.float32, device=device)
    matrix = torch.as_tensor(camera.matrix(), dtype=torch.float32, device=device)
    return rasterize(
        gaussians.means,
        gaussians.quats,
        gaussians.log_scales,
        gaussians.logit_opacities,
        gaussians.sh,
        viewmat[None],
        matrix[None],
        camera.width,
        camera.height,
        raw=True,
        **options,
    )


def load_camera_path(path: Path) -> list[tuple[str, Camera, Float64]]:
    """The cameras of a path file, as (name, camera, world_to_camera), in the file's order.

    Raises:
        ConfigError: the file is unreadable or malformed; the message names the camera.
    """
    hint = "See «camera path file» in the documentation of `render`."
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"Cannot read {path} ({error.strerror}).") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not JSON ({error}).", hint) from error
    records = document.get("cameras") if isinstance(document, dict) else None
    if not isinstance(records, list) or not records:
        raise ConfigError(f"{path} holds no list «cameras».", hint)
    cameras = []
    for index, record in enumerate(records):
        try:
            cameras.append(_camera_from_record(record))
        except KeyError as error:
            raise ConfigError(f"{path}: camera {index} has no {error}.", hint) from error
        except (TypeError, ValueError, OverflowError) as error:
            raise ConfigError(f"{path}: camera {index} is malformed ({error}).", hint) from error
    names = [safe_name(name).casefold() for name, _, _ in cameras]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"{path}: two cameras are named «{name}».", "Give each its own name.")
    return cameras


def _camera_from_record(record: Any) -> tuple[str, Camera, Float64]:
    """One entry of a path file; KeyError, TypeError or ValueError when it is malformed."""
    if not isinstance(record, dict):
        raise TypeError("not an object")
    name = record["name"]
    if not isinstance(name, str) or not name.strip():
        raise ValueError("its name must be text")
    sides = [record["width"], record["height"]]
    if any(type(side) is not int or not 0 < side <= MAX_SIDE for side in sides):
        raise ValueError(f"width and height must be whole numbers from 1 to {MAX_SIDE}")
    fx, fy, cx, cy = (float(record[key]) for key in ("fx", "fy", "cx", "cy"))
    if not (np.isfinite([fx, fy, cx, cy]).all() and fx > 0 and fy > 0):
        raise ValueError("fx and fy must be positive, cx and cy finite")
    pose = np.array(record["world_to_camera"], dtype=float)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise ValueError("world_to_camera must be 4 x 4 finite numbers")
    rotation = pose[:3, :3]
    rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4)
    if not (rigid and np.linalg.det(rotation) > 0 and np.allclose(pose[3], (0, 0, 0, 1))):
        raise ValueError("world_to_camera must be a rotation and a translation")
    camera = Camera(width=sides[0], height=sides[1], fx=fx, fy=fy, cx=cx, cy=cy)
    return name, camera, pose


def render_sequence(
    gaussians: Gaussians,
    cameras: CameraPath,
    out_dir: Path,
    emit: Emit = ignore,
    check: Check = go_on,
) -> list[Path]:
    """Render every camera to `out_dir/<name>.png` (8-bit sRGB); the files in the cameras' order."""
    emit(StageStarted(stage="render", total=len(cameras)))
    started = time.monotonic()
    written: list[Path] = []
    for name, camera, world_to_camera in cameras:
        check()
        path = Path(out_dir) / f"{safe_name(name)}.png"
        save_png(path, to_uint8(render_view(gaussians, camera, world_to_camera).image))
        emit(Preview(path=str(path)))
        written.append(path)
        done, count = len(written), len(gaussians)
        emit(step_done("render", done, len(cameras), started, gaussians=count))
    return written


def to_uint8(image: Tensor) -> NDArray[np.uint8]:
    """(H, W, 3) values in [0, 1] -> (H, W, 3) uint8, rounded to nearest."""
    return (image.detach().clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()


def save_png(path: Path, image: NDArray[np.uint8]) -> None:
    """Write (H, W, 3) uint8 as a PNG under `path`, whole or not at all."""
    with atomic_write(path) as file:
        Image.fromarray(image).save(file, format="PNG")


def safe_name(name: str) -> str:
    """`name` as one path component: letters of any script, digits, `-`, `.`, `_` and spaces.

    A name that had to be changed gets a short checksum, so that two names stay two files.
    """
    clean = re.sub(r"[^\w\-. ]+", "_", name).strip(" .")
    clean = clean[:80].rstrip(" .") or "unnamed"
    if clean == name:
        return clean
    return f"{clean}-{hashlib.sha1(name.encode('utf-8', 'backslashreplace')).hexdigest()[:6]}"
