"""`render-frames`: pictures of placed models for compositing, as another program asks for them.

Blender's render waits for each picture, so starting Python and reading models once per frame would
be slow: this command stays, and keeps the models that it has read.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from ..context import Context
from ..errors import ConfigError, EngineError
from ..formats.events import Preview
from ..formats.files import read_json
from ..formats.frame_requests import REQUEST, colour_file, depth_file
from .console import Console
from .drawn_model import drawn_model
from .options import add_device_option, add_threads_option, context_on_device
from .placed_models import HINT, placed_models
from .values import PATH

if TYPE_CHECKING:
    from ..model.gaussians import Gaussians
    from ..model.local_frame import LocalFrame

HELP = "render pictures for compositing, as another program asks for them in a folder"
EXAMPLES = """\
  python -m roigs_engine render-frames requests --once"""
STAGE = "models"
PAUSE = 0.005  # seconds between two looks into the folder


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument(
        "folder", type=PATH, help="folder of the requests, JSON files (docs/files.md)"
    )
    parser.add_argument("--once", action="store_true", help="end when no request is left")
    add_threads_option(parser)
    add_device_option(parser)


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Answer requests, oldest name first, until asked to stop."""
    from ..kernels.library import set_threads

    if not args.folder.is_dir():
        raise ConfigError(f"{args.folder} is not a folder.", "Give the folder of the requests.")
    if args.threads is not None:
        set_threads(args.threads)
    context = context_on_device(args, console)
    # As information: a program that waits for a picture takes a warning for a refusal.
    models = Models(context.info)
    while not console.should_stop():
        waiting = sorted(args.folder.glob(f"*{REQUEST}"))
        if not waiting:
            if args.once:
                break
            time.sleep(PAUSE)
            continue
        try:
            out = answer(waiting[0], models, context)
            console.emit(Preview(path=str(out)))
        except EngineError as error:
            if args.once:
                raise
            context.warn(str(error))
        finally:
            with suppress(OSError):
                waiting[0].unlink()
    return {}


class Models:
    """PLYs by path; one that has changed is read again, one that is not asked for is dropped.

    Args:
        say: gets a line for each file that is read and has Gaussians that cannot be drawn.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._read: dict[str, tuple[tuple[int, int], Gaussians, LocalFrame]] = {}

    def get(self, paths: list[str], context: Context) -> list[tuple[Gaussians, LocalFrame]]:
        """The models, without what cannot be drawn, and the frames that they are in.

        Args:
            paths: of their files.
            context: gets the progress: whoever waits for a picture sees that the engine works.

        Raises:
            EngineError: a file is missing or damaged.
        """
        known, self._read = self._read, {}
        different, started = dict.fromkeys(paths), time.monotonic()
        for step, path in enumerate(different, start=1):
            key, entry = _state(path), known.get(path)
            if entry is None or entry[0] != key:
                entry = key, *drawn_model(Path(path), self._say)
                context.progress(STAGE, step, len(different), started)
            self._read[path] = entry
        return [self._read[path][1:] for path in paths]


def _state(path: str) -> tuple[int, int]:
    """Time of change and size of a file; ConfigError if it cannot be read."""
    try:
        state = Path(path).stat()
    except OSError as error:
        reason = error.strerror or error
        raise ConfigError(f"Cannot read {path} ({reason}).", "Load results again.") from error
    return state.st_mtime_ns, state.st_size


def answer(request: Path, models: Models, context: Context) -> Path:
    """Render what a request asks for; returns the picture, which is written last.

    Args:
        request: its file.
        models: that were read before.
        context: has the device, and gets the progress.

    Raises:
        EngineError: the request is malformed, or a model cannot be read.
    """
    import torch

    from ..rasterize.camera_path import camera_from_record
    from ..rasterize.image_files import save_layer
    from ..rasterize.instances import Instance, render_instances

    record = read_json(request, ConfigError, HINT)
    try:
        _, camera, pose = camera_from_record(record["camera"])
        out = request.parent / record["out"]
        wanted = placed_models(record, request.parent)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{request} is malformed ({error}).", HINT) from error
    read = models.get([item.file for item in wanted], context)
    placed = [
        Instance(
            gaussians=gaussians,
            frame=frame,
            matrix=item.matrix,
            gains=item.gains,
            density=item.density,
        )
        for (gaussians, frame), item in zip(read, wanted, strict=True)
    ]
    layer = render_instances(placed, camera, pose, torch.device(context.device))
    save_layer(colour_file(out), depth_file(out), layer)
    return colour_file(out)
