"""Relighting: the engine draws the captured light, the texture is divided by it, lamps light it."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender import leave_edit_mode, load_image
from ..engine import own_files
from ..engine.writing import writing
from ..errors import AddonError
from ..geometry.frames import Matrix
from ..properties import object_props, scene_props
from ..scene import box_surfaces, captured_light, compared, lookup, ownership, proxies, relight
from ..scene.image_pixels import pixels_of
from ..shared import files, run_files
from ..windows import redraw
from . import options_files, run_folders
from .spec import RELIGHTING, JobSpec

PICTURE, MODELS = "captured_light.hdr", "captured_light.json"
WIDTH = 256
"""Width of the picture in pixels: small, because matt surfaces average a whole hemisphere."""
NO_RESULT = "There is no result to take the captured light from. Train first."
GONE = "The mesh '{}' is gone. Make its surface again."


def spec(scene: bpy.types.Scene, item: bpy.types.Object) -> JobSpec:
    """Return the job that relights a box's mesh.

    The light is drawn from the last result without the box, so the object hides none of it.

    Raises:
        AddonError: there is no result, or the run folder cannot be written to.
    """
    folder, find = run_folders.settle(scene), run_folders.finder(scene)
    result = (compared.shown_result(scene) or folder) / run_files.RESULT
    if not result.is_file():
        raise AddonError(NO_RESULT)
    root = lookup.matrix_world(scene_props(scene).root)
    turn = root[:3, :3] / np.cbrt(abs(np.linalg.det(root[:3, :3])))
    picture, roi = options_files.own_folder(scene) / PICTURE, object_props(item).roi
    box = ownership.box_of(scene, item)
    models = picture.with_name(MODELS)
    with writing(picture.parent, "Run Folder"):
        for file in (picture, run_files.mirrored(picture)):
            file.unlink(missing_ok=True)
        upright = {"ply": str(result), "matrix": root.tolist()}  # levelled as in Blender: z is up
        files.write_json(models, {"models": [upright]})
    place = root @ np.array((*captured_light.middle_of(item), 1.0))

    def show() -> str | None:
        now = find()
        if now is None:
            return None
        mesh = box_surfaces.surface_of_box(now, box)
        if mesh is None:
            raise AddonError(GONE.format(roi))
        light(now, mesh, picture, turn)
        redraw()
        return f"'{mesh.name}' is lit by your lamps and world"

    return JobSpec(
        title=RELIGHTING,
        arguments=[
            *("panorama", str(models), f"--run={result.parent}", f"--without={roi}"),
            f"--at={','.join(f'{number:.9g}' for number in place[:3])}",
            *(f"--out={picture}", f"--width={WIDTH}", *options_files.machine_options()),
        ],
        log=own_files.log_file(folder),
        folder=folder,
        on_done=show,
        done_text="The object is relit",
    )


def light(scene: bpy.types.Scene, item: bpy.types.Object, picture: Path, turn: Matrix) -> None:
    """Relight a mesh, and show it instead of the Gaussians.

    Raises:
        AddonError: the picture cannot be read, or the mesh has no texture.
    """
    leave_edit_mode([item])
    relight.apply(item, _pixels(picture), turn)
    box_surfaces.set_way(scene, item, box_surfaces.MESH)
    proxies.settle(scene)


def _pixels(path: Path) -> NDArray[np.float32]:
    """(H, W, 3) linear light of an image file."""
    image = load_image(path)
    if image is None:
        raise AddonError(f"{path} cannot be read. Click Relight again.")
    found = pixels_of(image)[::-1, :, :3]
    bpy.data.images.remove(image)
    if not found.size:
        raise AddonError(f"{path} has no picture. Click Relight again.")
    return found
