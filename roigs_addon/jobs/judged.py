"""Writes visible Gaussians to files for the engine, and maps its answers to the points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender import leave_edit_mode, mesh_of, scene_of
from ..engine.writing import writing
from ..errors import AddonError
from ..geometry.splat_cloud import write_splats
from ..scene import edits, lookup, point_edits
from ..scene.splat_attributes import cloud_of, drawn
from ..shared import files

FOLDER = "temporary folder in Blender's preferences"


@dataclass(frozen=True)
class Judged:
    """The visible Gaussians of a scene, as they were written.

    Attributes:
        listed: file with the list of models, which names their files.
        out: path of the engine's answer, a NumPy file with a row for each Gaussian.
        looked_at: `session_uid` and state of each mesh, in the order of the list.
        wanted: `session_uid` of the meshes that need an answer; the others only hide these.
    """

    listed: Path
    out: Path
    looked_at: tuple[tuple[int, str], ...]
    wanted: frozenset[int]

    @staticmethod
    def write(context: bpy.types.Context, name: str) -> Judged:
        """Write the Gaussians to Blender's temporary folder, with this prefix.

        AddonError: there are no Gaussians, or they cannot be written.
        """
        scene = scene_of(context)
        leave_edit_mode(lookup.splats(scene))
        wanted = frozenset(_uid(item) for item in point_edits.checked_targets(context))
        folder = Path(bpy.app.tempdir)
        listed = folder / f"{name}-models.json"
        with writing(folder, FOLDER):
            judged = [_written(i, scene, folder, name) for i in point_edits.visible(context)]
            models = [model for _, model in judged]
            files.write_json(listed, {"models": models}, durable=False)
        looked_at = tuple(known for known, _ in judged)
        return Judged(listed, folder / f"{name}.npy", looked_at, wanted)

    def rows(
        self, scene: bpy.types.Scene, otherwise: float, again: str
    ) -> dict[bpy.types.Object, NDArray[Any]]:
        """Return object -> the answer for each of its points; one object if several share them.

        The objects are in object mode then.

        Args:
            scene: of the Gaussians, as it is now.
            otherwise: value of points that are not drawn.
            again: advice for the error if the Gaussians have changed meanwhile.

        AddonError: they have changed, or the answer cannot be read.
        """
        try:
            every = np.load(self.out, allow_pickle=False)
        except (OSError, ValueError) as error:
            raise AddonError(f"The engine's answer is unreadable ({error}).") from error
        leave_edit_mode(lookup.splats(scene))
        changed = AddonError(f"The Gaussians were changed meanwhile. {again}")
        items = {_uid(i): i for i in reversed(lookup.splats(scene)) if i.type == "MESH"}
        found: dict[bpy.types.Object, NDArray[Any]] = {}
        begin = 0
        for uid, state in self.looked_at:
            item = items.get(uid)
            if item is None or edits.state_of(mesh_of(item)) != state:
                raise changed
            there = drawn(mesh_of(item))
            count = int(there.sum())
            if begin + count > len(every):
                raise changed
            if item not in found and uid in self.wanted:
                found[item] = np.full((len(there), *every.shape[1:]), otherwise, every.dtype)
                found[item][there] = every[begin : begin + count]
            begin += count
        return found


def _uid(item: bpy.types.Object) -> int:
    return int(mesh_of(item).session_uid)


def _written(
    item: bpy.types.Object, scene: bpy.types.Scene, folder: Path, name: str
) -> tuple[tuple[int, str], dict[str, Any]]:
    """Write an object's Gaussians; return its mesh and state, and the model in the COLMAP frame."""
    mesh = mesh_of(item)
    found = cloud_of(mesh)
    if found is None:
        raise AddonError(f"'{item.name}' is no longer an object of Gaussians. Import it again.")
    cloud, applied = found
    path = folder / f"{name}-{mesh.session_uid}.ply"
    write_splats(path, cloud)
    root = lookup.from_world(scene)
    matrix = root @ lookup.matrix_world(item) @ applied
    return (_uid(item), edits.state_of(mesh)), {"ply": str(path), "matrix": matrix.tolist()}
