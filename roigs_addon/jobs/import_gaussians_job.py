"""Importing Gaussians: the engine converts a file of any format to a PLY in the run folder.

It stays there with the scene, even if the imported file is moved or deleted.
"""

from __future__ import annotations

import os
from pathlib import Path

import bpy
import numpy as np

from ..blender import scene_of, select_only, view_layer_of
from ..engine.own_files import IMPORTED, OWN
from ..engine.writing import made_folder
from ..errors import AddonError
from ..geometry.rounding import rounding
from ..properties import scene_props
from ..scene import clouds, lookup, splats
from ..windows import frame_views
from . import current, run_folders
from .spec import IMPORTING_GAUSSIANS, JobSpec

ENDINGS = (".compressed.ply", ".ply", ".spz", ".sog", ".glb", ".usdc", ".usda", ".usdz", ".splat")
"""Endings of files that can be imported and exported."""

ONLY_IMPORTED = (".gltf", ".usd", "meta.json")
"""Endings of files that can only be imported; `meta.json` is the name of an unpacked SOG."""

LOG = "import.log"
TOO_FAR = "{} {}. Move it to the origin before you import it (docs/reliability.md says how)."
MOST_LETTERS = 80  # of a name, before its number and ending


def spec(context: bpy.types.Context, source: Path, up: str) -> JobSpec:
    """Return the job that imports a file.

    Args:
        context: its scene gets the object.
        source: the file.
        up: axis that points up in it, as for `convert`. Empty: as the file says, else the format's
            own. `colmap`: the file is in the frame of the scene's COLMAP model.

    Raises:
        AddonError: there is no such file or no model, or the run folder cannot be written to.
    """
    scene = scene_of(context)
    if not os.path.isfile(source):
        raise AddonError(f"There is no file {source}. Choose a file of Gaussians.")
    in_model = up == "colmap"
    if in_model and not has_model(scene):
        raise AddonError("There are no cameras. Import some first, or choose another axis.")
    name = _name(source)
    folder = made_folder(run_folders.settle(scene), OWN, IMPORTED)
    path = free_file(folder, name)
    before = [f"--from-up={'z' if in_model else up}"] if up else []
    find = run_folders.finder(scene)

    def build() -> None:
        now = find()
        if now is None:
            return
        item = splats.show_imported(now, path, name, in_model=in_model and has_model(now))
        lost = rounding(clouds.positions(item) + np.array(item.location))
        if lost:
            current.warn(TOO_FAR.format(name, lost))
        if bpy.context.scene == now and bpy.context.mode == "OBJECT":  # edits stay active
            select_only(bpy.context, item)
        view_layer_of(bpy.context).update()
        world = lookup.matrix_world(item)
        frame_views(now, clouds.positions(item) @ world[:3, :3].T + world[:3, 3])

    return JobSpec(
        title=IMPORTING_GAUSSIANS,
        arguments=["convert", str(source), str(path), "--up=z", *before],
        log=folder / LOG,
        on_done=build,
        done_text=f"Imported {name}",
    )


def has_model(scene: bpy.types.Scene) -> bool:
    """Whether the scene has the root of a COLMAP model."""
    root = scene_props(scene).root
    return root is not None and root.name in scene.objects


def _name(source: Path) -> str:
    """Return the file's name without its ending, encoded so that Blender can show it."""
    if source.name.lower() in ONLY_IMPORTED:
        source = source.parent
    name = source.name
    ending = next((e for e in ENDINGS if name.lower().endswith(e)), source.suffix)
    stem = name[: len(name) - len(ending)] or "Gaussians"
    return stem.encode("utf-8", "replace").decode()[:MOST_LETTERS]


def free_file(folder: Path, name: str) -> Path:
    """Return the path of a PLY that does not exist: objects may show earlier ones of that name."""
    number, path = 1, folder / f"{name}.ply"
    while os.path.lexists(path):
        number += 1
        path = folder / f"{name}-{number}.ply"
    return path
