"""Making surfaces: the engine makes meshes of a result's boxes, which replace the Gaussians."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import bpy

from ..blender import scene_of, view_layer_of
from ..engine import own_files, run_status
from ..errors import AddonError
from ..properties import object_props, scene_props
from ..scene import box_surfaces, compared, lookup, ownership, rois
from ..shared import run_files, text
from ..windows import redraw
from . import options_files, run_folders
from .spec import SURFACES, JobSpec

EDITED = "'{}' was edited since it was made. {}"
GLB = ".glb"


def box_at_hand(context: bpy.types.Context) -> tuple[str, bool]:
    """Find the user's current box: that of the active Gaussians or mesh, else the active box.

    Returns its name, empty if there is none, and whether this is its name in the run folder.
    """
    item, roi = view_layer_of(context).objects.active, lookup.active_roi(context)
    own = item if item is not None and ownership.is_own(scene_of(context), item) else None
    if own is not None and (name := object_props(own).roi):
        return name, True
    return (roi.name, False) if roi is not None else ("", False)


def trained_name(scene: bpy.types.Scene, roi: str) -> str:
    """Return the name of a box in the run folder: it may have been renamed since its training."""
    status = run_status.read(run_folders.run_folder(scene))
    return rois.trained_names(scene, status.boxes or {}).get(roi, roi)


def spec(scene: bpy.types.Scene, boxes: Sequence[str], *, replace_edits: bool) -> JobSpec:
    """Return the job that makes meshes of the last result's boxes, and shows them.

    Args:
        scene: of the result.
        boxes: their names in the run folder; empty for all.
        replace_edits: also replace meshes that the user has edited.

    Raises:
        AddonError: the run folder cannot be written to, or a mesh was edited.
    """
    folder, find = run_folders.settle(scene), run_folders.finder(scene)
    if not replace_edits:
        _refuse_edited(scene, boxes, "To replace it, give replace_edits=True.")
    made: dict[str, Path] = {}
    before = _made(folder)

    def take(outputs: Mapping[str, str]) -> None:
        made.update({n: Path(path) for n, path in outputs.items() if path.endswith(GLB)})

    def show() -> str | None:
        now = find()
        if now is None:
            return None
        if not replace_edits:  # they may have been edited meanwhile
            _refuse_edited(now, list(made), "Click the button again to replace it.")
        compared.show_last(now, folder)
        for name, path in made.items():
            box_surfaces.show(now, name, path)
        redraw()
        return f"Made {text.counted(len(made), 'surface')}"

    def show_finished() -> None:
        """Show meshes finished before a stop. Edited meshes stay, as nobody can be asked."""
        fresh = {path: stamp for path, stamp in _made(folder).items() if before.get(path) != stamp}
        if fresh and (now := find()) is not None:
            edited = box_surfaces.edited(now, [path.stem for path in fresh])
            compared.show_last(now, folder)
            for path in fresh:
                known = box_surfaces.surface_of(now, path.stem)
                if known is None or known.name not in edited:
                    box_surfaces.show(now, path.stem, path)
            redraw()

    return JobSpec(
        title=SURFACES,
        arguments=["surface", str(folder), *_options(scene, folder, boxes)],
        log=own_files.log_file(folder),
        folder=folder,
        then=take,
        on_done=show,
        on_stop=show_finished,
        words=options_files.MOVED,
        done_text="The surface is made",
    )


def _options(scene: bpy.types.Scene, folder: Path, boxes: Sequence[str]) -> list[str]:
    props = scene_props(scene)
    options = [*(f"--only={name}" for name in boxes), f"--faces={props.faces}"]
    options += ["--watertight"] if props.watertight else []
    options += [f"--texture-size={props.texture_size}"] if props.texture_size else []
    moved = options_files.moved_scene(scene, folder)
    return [*options, *moved, *options_files.machine_options()]


def _made(folder: Path) -> dict[Path, int]:
    """Return the meshes in a run folder -> time of their record, which is written last."""
    found = {}
    for path in (folder / run_files.FINE).glob(f"*{GLB}"):
        with suppress(OSError):
            found[path] = box_surfaces.record_file(path).stat().st_mtime_ns
    return found


def _refuse_edited(scene: bpy.types.Scene, boxes: Sequence[str], remedy: str) -> None:
    if names := box_surfaces.edited(scene, boxes):
        raise AddonError(EDITED.format(names[0], remedy))
