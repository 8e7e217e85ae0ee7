"""Blender's own Gaussian splats (5.3 and later): conversion from the add-on's objects, and back.

Blender's PLY importer turns a 3DGS PLY into a point cloud object with the attributes of
docs/conventions.md. Values stay in the file's own frame; a change of axes goes into the object's
matrix. The importer's result is checked; any other object is removed. Blender draws all splats in
its own way. Their target is only stored, for converting back.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from .. import blender
from ..blender import delete, mesh_of, view_layer_of
from ..engine.writing import writing
from ..errors import AddonError
from ..geometry.splat_cloud import SH_C0, SplatCloud, write_splats
from . import look, lookup
from .splat_attributes import (
    SHAPE,
    cloud_of,
    mark_photo_focal,
    mark_target,
    photo_focal_of,
    sh_of,
    targets_of,
    values,
)

FIRST_VERSION = (5, 3, 0)
POSITION = "position"
UNCHANGED = {"forward_axis": "Y", "up_axis": "Z", "global_scale": 1.0, "use_scene_unit": False}
"""Options of the importer that change no axes or units."""
NAME = "roigs-native.ply"
"""Name of the file in Blender's temporary folder."""
REFUSED = "This Blender's PLY importer makes no Gaussian splats."


def exist() -> bool:
    """Whether this Blender has splats of its own."""
    return bpy.app.version >= FIRST_VERSION


def are_in(item: bpy.types.Object) -> bool:
    """Whether an object consists of Blender's own splats."""
    attributes = {attribute.name for attribute in getattr(item.data, "attributes", ())}
    return item.type == "POINTCLOUD" and attributes >= {POSITION, *SHAPE}


def of(item: bpy.types.Object) -> bpy.types.Object:
    """Create an object of Blender's own splats from an object of Gaussians.

    Raises:
        AddonError: the object has no Gaussians, its edits cannot be written, or Blender refused.
    """
    found = cloud_of(mesh_of(item))
    if found is None:
        raise AddonError(f"'{item.name}' is no longer an object of Gaussians. Import it again.")
    cloud, applied = found
    if not len(cloud):
        raise AddonError(f"'{item.name}' has no Gaussians left.")
    path = Path(bpy.app.tempdir) / NAME
    with writing(path.parent, "temporary folder in Blender's preferences"):
        write_splats(path, _shaded(cloud, look.gains(item)), durable=False)
    made = _imported(path)
    path.unlink(missing_ok=True)
    if made is None:
        raise AddonError(REFUSED)
    points: Any = made.data
    mark_target(points, cloud.target)
    mark_photo_focal(points, cloud.photo_focal)
    made.name = f"{item.name} Splats"
    made.matrix_world = Matrix((lookup.matrix_world(item) @ applied).tolist())
    for collection in list(made.users_collection):
        collection.objects.unlink(made)
    for collection in item.users_collection:
        collection.objects.link(made)
    return made


def cloud_in(item: bpy.types.Object) -> SplatCloud:
    """Return the Gaussians of an object of Blender's own splats, in the object's frame."""
    data: Any = item.data
    columns = [values(data, name) for name in (POSITION, *SHAPE)]
    means, scales, quats, radiance = columns
    if means is None or scales is None or quats is None or radiance is None:
        raise AddonError(f"'{item.name}' has attributes of another kind than Blender's splats.")
    return SplatCloud(
        means=means,
        quats=quats,
        scales=scales,
        opacities=radiance[:, 3],
        sh=sh_of(data),
        target=targets_of(data)[0],
        photo_focal=photo_focal_of(data),
    )


def _shaded(cloud: SplatCloud, gains: look.Gains) -> SplatCloud:
    """Return the cloud with its colours, 0.5 + SH, multiplied by gains."""
    factors = np.array(gains, np.float32)
    sh = cloud.sh * factors
    sh[:, 0] += 0.5 * (factors - 1) / SH_C0
    return replace(cloud, sh=sh)


def _imported(path: Path) -> bpy.types.Object | None:
    """Import a PLY as an object at the origin; None if Blender makes anything else of it."""
    with _undisturbed():
        before = set(bpy.data.objects)
        # The operator may be missing, report an error, or lack these options.
        with suppress(AttributeError, RuntimeError, TypeError):
            importer: Any = bpy.ops.wm
            importer.ply_import(filepath=str(path), **UNCHANGED)
        made = [item for item in bpy.data.objects if item not in before]
        if len(made) == 1 and are_in(made[0]):
            made[0].matrix_basis = Matrix()
            return made[0]
        for item in made:
            delete(item)
        return None


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Give the importer a context, and restore the user's selection afterwards."""
    with bpy.context.temp_override(
        window=bpy.context.window or next(iter(blender.windows()), None)
    ):
        layer = view_layer_of(bpy.context)
        active, selected = layer.objects.active, {o for o in layer.objects if o.select_get()}
        yield
        for item in layer.objects:
            item.select_set(item in selected)
        layer.objects.active = active
