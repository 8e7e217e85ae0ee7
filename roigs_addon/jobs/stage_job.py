"""Preparing the scene for the user's objects: a panorama, and a mesh of the background.

A job makes the missing files, one command after the other. Then it adds everything to the scene at
once, so that one undo reverts all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from ..blender import load_image
from ..engine import own_files
from ..engine.writing import writing
from ..errors import AddonError
from ..properties import scene_props
from ..scene import instances, lookup, proxies, stage, stage_world
from ..scene.frame_request import models_of, shown
from ..shared import files, run_files, text, transforms
from ..windows import redraw
from . import options_files, run_folders
from .spec import STAGING, JobSpec

PANORAMA, MODELS = "panorama.hdr", "panorama.json"
WIDTH = 1024
BACKGROUND_MESH = Path(run_files.FINE, f"{run_files.SURROUNDINGS}.glb")
NOTHING_SEEN = "No Gaussians are shown in renders. Load results, or show them."


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """The wanted light and meshes of a scene.

    Attributes:
        light: place of the panorama, in the world; None for no light.
        radius: of the object there, in units of the world; 0 if there is none.
        shadows: whether captured surfaces catch shadows, and are reflected.
        then: called when everything is in the scene.
    """

    light: Vector | None = None
    radius: float = 0.0
    shadows: bool = False
    then: Callable[[bpy.types.Scene], None] | None = None


def background_mesh(folder: Path) -> Path | None:
    """Return a run folder's mesh of the scene outside the boxes; None if there is none yet."""
    path = folder / BACKGROUND_MESH
    return path if path.is_file() else None


def spec(scene: bpy.types.Scene, wanted: Wanted) -> JobSpec:
    """Return the job that makes the missing files; the panorama comes last.

    Raises:
        AddonError: no Gaussians are shown, or the run folder cannot be written to.
    """
    folder, find = run_folders.settle(scene), run_folders.finder(scene)
    picture = options_files.own_folder(scene) / PANORAMA
    with writing(picture.parent, "Run Folder"):
        for file in (picture, run_files.mirrored(picture)):
            file.unlink(missing_ok=True)

    def show() -> str | None:
        now = find()
        if now is None:
            return None
        said = apply(now, folder, wanted, picture)
        redraw()
        return said

    parts = []
    if _lacks_mesh(folder, wanted):
        parts.append(["surface", str(folder), "--background"])
    if wanted.light is not None:
        parts.append(_panorama(scene, wanted, folder, picture))
    return _chain(parts, folder, show)


def is_needed(scene: bpy.types.Scene, wanted: Wanted) -> bool:
    """Whether the engine has to make a file for this."""
    return wanted.light is not None or _lacks_mesh(run_folders.run_folder(scene), wanted)


def _lacks_mesh(folder: Path, wanted: Wanted) -> bool:
    """Whether the background's mesh must be made. Gaussians without a run have none."""
    trained = (folder / run_files.RESULT).is_file()
    return wanted.shadows and trained and background_mesh(folder) is None


def _panorama(scene: bpy.types.Scene, wanted: Wanted, folder: Path, picture: Path) -> list[str]:
    """Return the command that draws the rendered Gaussians as a panorama, in the COLMAP frame.

    Gaussians in the place of the user's object are left out.
    """
    assert wanted.light is not None
    root = lookup.matrix_world(scene_props(scene).root)
    back, scale = lookup.from_world(scene), transforms.scale_of(root) or 1.0
    depsgraph = bpy.context.evaluated_depsgraph_get()
    models = models_of(shown(scene), instances.instances(depsgraph), depsgraph)
    if not models:
        raise AddonError(NOTHING_SEEN)
    placed = [{**model, "matrix": (back @ model["matrix"]).tolist()} for model in models]
    listed = picture.with_name(MODELS)
    with writing(picture.parent, "Run Folder"):
        files.write_json(listed, {"models": placed})
    place = back @ np.array((*wanted.light.to_tuple(), 1.0))
    return [
        *("panorama", str(listed)),
        *([f"--run={folder}"] if (folder / run_files.MANIFEST).is_file() else []),
        f"--at={','.join(f'{number:.9g}' for number in place[:3])}",
        *(f"--near={wanted.radius / scale:.6g}", f"--out={picture}", f"--width={WIDTH}"),
    ]


def keep_standing() -> None:
    """Do nothing: after a stop, an object that was put on a surface stays, with an undo step."""


def _chain(parts: list[list[str]], folder: Path, show: Callable[[], str | None]) -> JobSpec:
    """Return one job of several commands; after the last one, it calls `show`."""
    arguments = [*parts[0], *options_files.machine_options()]
    spec = JobSpec(
        title=STAGING,
        arguments=arguments,
        log=own_files.log_file(folder),
        folder=folder,
        on_done=show,
        on_stop=keep_standing,
        done_text="Light and shadows are set",
    )
    if len(parts) == 1:
        return spec

    def go_on(_: Mapping[str, str]) -> JobSpec | None:
        return _chain(parts[1:], folder, show)

    return replace(spec, then=go_on)


def apply(scene: bpy.types.Scene, folder: Path, wanted: Wanted, picture: Path | None) -> str:
    """Add the wanted light and proxies to the scene; return what was done, in words.

    Raises:
        AddonError: a file is damaged.
    """
    said = []
    if wanted.shadows:
        made = proxies.bring(scene, background_mesh(folder))
        stage.multiply(scene)
        said.append(f"{text.counted(len(made), 'captured surface')} made to catch shadows")
    if wanted.light is not None and picture is not None:
        image = read_picture(picture)
        seen = run_files.mirrored(picture)
        mirror = read_picture(seen) if seen.is_file() else None
        stage_world.shine(scene, image, scene_props(scene).root, wanted.light, mirror)
        proxies.set_reach(scene, wanted.radius or proxies.usual_radius(scene))
        said.append("the world has the scene's light")
    if wanted.then is not None:
        wanted.then(scene)
    whole = ", ".join(said)
    return whole[:1].upper() + whole[1:]


def read_picture(path: Path) -> bpy.types.Image:
    """Load a picture and pack it into the .blend.

    Raises:
        AddonError: it cannot be read.
    """
    image = load_image(path)
    try:
        if image is None:
            raise RuntimeError("no picture")
        image.pack()
    except RuntimeError as error:
        raise AddonError(f"{path} cannot be read. Click Light From Scene again.") from error
    image.name = stage_world.NAME
    return image
