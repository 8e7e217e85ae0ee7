"""Renders trained models from given cameras, and for compositing in another program."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..context import QUIET, Context
from ..errors import ConfigError, EngineError, Stopped
from ..formats.events import Preview
from ..formats.files import read_json, regular
from ..formats.frame_requests import REQUEST, colour_file, is_request
from ..formats.names import usable_path
from ..formats.projects import model_folders, project_folder
from ..formats.text import counted, first_line
from ..requests.models import Render, RenderFrames
from .inputs import load_scene, on_device, use_threads
from .instances import HINT, InstanceRecord, drawable_model, instances
from .outputs import Result, refuse_run_files
from .run_scene import levelled_run

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from torch import Tensor

    from ..model.gaussians import Gaussians
    from ..model.local_frame import LocalFrame
    from ..model.scene import Camera, Float64
    from ..rasterize.camera_path import CameraPath
    from ..rasterize.instances import Layer

STAGE, SAMPLES = "models", "samples"
MOST_SAMPLES = 1024
OWN_FOLDER = "Give a folder of its own for the requests."
PAUSE = 0.005  # seconds between two looks into the folder


def render(request: Render, context: Context = QUIET) -> Result:
    """Render a PLY from every camera to a PNG; EngineError if an input cannot be used."""
    import torch

    from ..levels.parts import LevelledResult
    from ..rasterize.image_files import render_sequence

    refuse_run_files(request.out)
    if request.path and request.images:
        raise ConfigError("--images has no meaning with --path.", "Leave it out.")
    whole, frame = drawable_model(request.ply, context.warn, context.check_cancelled)
    context = on_device(context, request.device)
    device = torch.device(context.device)
    whole = whole.to(device)
    levels = None
    if request.levels:
        folder = levelled_run(request.ply)
        levels = LevelledResult(folder, frame, quality=request.quality, device=device)
    cameras = _cameras(request, context)
    local = [(name, camera, frame.transform(pose)) for name, camera, pose in cameras]

    def drawn(camera: Camera, world_to_camera: Float64) -> Gaussians:
        return whole if levels is None else levels.gaussians(camera, world_to_camera)

    written = render_sequence(drawn, local, request.out, context)
    text = f"{counted(len(written), 'picture')} in {request.out}"
    return Result(files={"pictures": request.out}, text=text)


def _cameras(request: Render, context: Context) -> CameraPath:
    """Return the scene's or path's cameras, only named ones if any, at the request's size."""
    from ..colmap.project import smaller
    from ..rasterize.camera_path import load_camera_path

    if request.path is None:
        scene = load_scene(request, context)
        cameras = [(i.name, i.camera, i.world_to_camera) for i in scene.images]
    else:
        use_threads(request.threads)
        shrink = smaller(request.downscale, request.max_side)
        cameras = [
            (name, camera.resized(*shrink(camera.width, camera.height)), pose)
            for name, camera, pose in load_camera_path(request.path)
        ]
    unknown = sorted(set(request.name) - {name for name, _, _ in cameras})
    if unknown:
        first = ", ".join(f"'{name}'" for name, _, _ in cameras[:3])
        raise ConfigError(
            f"There is no camera '{unknown[0]}' in {request.path or request.scene}.",
            f"The first ones are: {first}.",
        )
    return [each for each in cameras if not request.name or each[0] in request.name]


# --- frames for compositing ---


def render_frames(request: RenderFrames, context: Context = QUIET) -> Result:
    """Answer the requests in a folder, oldest name first, until asked to stop.

    Blender's render waits for each picture, so starting Python and reading models once per frame
    would be slow. This keeps running, and keeps the models in memory.

    Raises:
        ConfigError: there is no such folder, or it is of a run or a COLMAP project.
        EngineError: with `once`, a request that cannot be answered.
    """
    if not request.folder.is_dir():
        raise ConfigError(f"{request.folder} is not a folder.", OWN_FOLDER)
    refuse_run_files(request.folder, option="The folder")
    if model_folders(project_folder(request.folder)):
        raise ConfigError(f"{request.folder} is a COLMAP project.", OWN_FOLDER)
    use_threads(request.threads)
    context = on_device(context, request.device)
    # As information: a program that waits for a picture takes a warning as a failure.
    models = Models(context.info)
    skipped: dict[Path, int] = {}  # files that stay: their times
    while not context.should_stop():
        found = sorted(request.folder.glob(f"*{REQUEST}"))
        waiting = [path for path in found if skipped.get(path) != _changed(path)]
        if not waiting:
            if request.once:
                break
            if not request.folder.is_dir():
                raise ConfigError(f"{request.folder} was deleted.", "Give another folder.")
            time.sleep(PAUSE)
            continue
        try:
            out = answer(waiting[0], models, context)
            context.emit(Preview(path=str(out)))
        except Stopped:
            break
        except EngineError as error:
            if request.once:
                raise
            context.warn(str(error))
        finally:
            if not _deleted(waiting[0]):
                skipped[waiting[0]] = _changed(waiting[0])
    return Result()


def _deleted(path: Path) -> bool:
    """Delete a request; False: it is something else, or it cannot be deleted."""
    with suppress(EngineError, OSError):
        if is_request(read_json(path)):
            path.unlink()
            return True
    return False


def _changed(path: Path) -> int:
    """Return the modification time of a file in ns; 0 if it is gone."""
    with suppress(OSError):
        return path.stat().st_mtime_ns
    return 0


class Models:
    """A cache of PLYs by path. A changed file is read again, and unused ones are dropped.

    `say` gets a line for each file with Gaussians that cannot be drawn.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._read: dict[str, tuple[tuple[int, int], Gaussians, LocalFrame]] = {}

    def get(self, paths: list[str], context: Context) -> list[tuple[Gaussians, LocalFrame]]:
        """Return the models' drawable Gaussians, and their frames; EngineError if one is damaged.

        The context gets the progress, so a program that waits for a picture sees that the engine
        is working.
        """
        known, self._read = self._read, {}
        different, started = dict.fromkeys(paths), time.monotonic()
        for step, path in enumerate(different, start=1):
            try:
                state = Path(path).stat()
            except OSError as error:
                text = f"Cannot read {path} ({error.strerror or error})."
                raise ConfigError(text, "Load results again.") from error
            key, entry = (state.st_mtime_ns, state.st_size), known.get(path)
            if entry is None or entry[0] != key:
                entry = key, *drawable_model(Path(path), self._say, context.check_cancelled)
                context.progress(STAGE, step, len(different), started)
            self._read[path] = entry
        return [self._read[path][1:] for path in paths]


class Sample(NamedTuple):
    """A sharp picture of a request: its camera, (4, 4) world_to_camera, models and surfaces."""

    camera: Camera
    pose: Float64
    models: list[InstanceRecord]
    surfaces: Path | None  # (T, 3, 3) float32 corners of triangles that hide Gaussians, as .npy
    rays: Path | None  # (H, W, 3) float32 directions of a panorama's pixels, as .npy


def answer(request: Path, models: Models, context: Context) -> Path:
    """Render the picture of a request file; return its path. The picture is written last.

    EngineError: the file is no request or malformed, or another one cannot be read.
    """
    from ..rasterize.image_files import save_layer
    from ..rasterize.instances import mean_layer

    record = read_json(request, ConfigError, HINT)
    if not is_request(record):
        raise ConfigError(f"{request} is not a request for a picture; it stays.", HINT)
    try:
        out = request.parent / usable_path(record["out"])
        if not out.name:
            raise ValueError(f"out is {str(out)!a:.60}, which names no file")
        blurred = "samples" in record
        samples = [_sample(each, request.parent) for each in record.get("samples", [record])]
        if not 0 < len(samples) <= MOST_SAMPLES:
            raise ValueError(f"samples must be from 1 to {MOST_SAMPLES}")
        if blurred and any(sample.rays for sample in samples):
            raise ValueError("samples have no rays")
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{request} is malformed ({error}).", HINT) from error
    layers = _layers(samples, models, context, mattes=record.get("mattes") is True)
    below = record.get("transparent") is True
    layer = mean_layer(layers, below=below) if blurred else next(layers)[0]
    save_layer(out, layer)
    return colour_file(out)


def _sample(record: Any, folder: Path) -> Sample:
    """Parse a sample of a request; KeyError, TypeError, ValueError, OverflowError if malformed."""
    from ..rasterize.camera_path import camera_from_record

    _, camera, pose = camera_from_record(record["camera"])
    paths = [
        None if (path := record.get(name)) is None else folder / usable_path(path)
        for name in ("surfaces", "rays")
    ]
    return Sample(camera, pose, instances(record, folder), *paths)


def _layers(
    samples: list[Sample], models: Models, context: Context, *, mattes: bool
) -> Iterator[tuple[Layer, Tensor]]:
    """Render each sample's layer, and the depth of its surfaces."""
    import torch

    from ..rasterize.instances import render_instances, surface_depth
    from ..rasterize.panorama import render_panorama

    device = torch.device(context.device)
    paths = list(dict.fromkeys(item.file for sample in samples for item in sample.models))
    read = dict(zip(paths, models.get(paths, context), strict=True))
    last, triangles, started = None, torch.zeros(0, 3, 3), time.monotonic()
    for step, sample in enumerate(samples, start=1):
        context.check_cancelled()
        if sample.surfaces is not None and sample.surfaces != last:
            found = _floats(sample.surfaces, (-1, 3, 3), "triangles: (T, 3, 3)")
            last, triangles = sample.surfaces, torch.from_numpy(found)
        shown = triangles if sample.surfaces is not None else triangles[:0]
        posed = [item.of(*read[item.file]) for item in sample.models]
        if sample.rays is None:
            layer = render_instances(posed, sample.camera, sample.pose, device, mattes=mattes)
        else:
            size = sample.camera.height, sample.camera.width
            rays = torch.from_numpy(_floats(sample.rays, (*size, 3), "rays of the picture's size"))
            density, pose = sample.camera.fx, sample.pose
            layer = render_panorama(posed, rays, density, pose, device, mattes=mattes)
        yield layer, surface_depth(shown, sample.camera, sample.pose)
        context.progress(SAMPLES, step, len(samples), started)


def _floats(path: Path, shape: tuple[int, ...], what: str) -> NDArray[np.float32]:
    """Read finite float32 numbers from a .npy file; -1 in the shape allows any size.

    ConfigError: the file is missing, or holds something else.
    """
    try:
        with open(path, "rb", opener=regular) as file:
            found = np.load(file, allow_pickle=False)
    except Exception as error:  # numpy's reader raises nearly anything on damaged files
        raise ConfigError(f"Cannot read {path} ({first_line(error)}).", HINT) from error
    if not isinstance(found, np.ndarray) or found.dtype != np.float32 or found.ndim != len(shape):
        raise ConfigError(f"{path} has no {what} float32.", HINT)
    if any(wanted not in (-1, size) for wanted, size in zip(shape, found.shape, strict=True)):
        raise ConfigError(f"{path} has no {what} float32.", HINT)
    if not np.isfinite(found).all():
        raise ConfigError(f"{path} has a number that is not finite.", HINT)
    return found
