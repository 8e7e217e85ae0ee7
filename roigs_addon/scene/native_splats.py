"""Blender's own Gaussian splats (5.3 and later), behind a probe of what its PLY importer makes.

No build of 5.3 was available when this was written; it follows the importer's source. There, a
3DGS PLY becomes a point cloud object with the attributes of `ATTRIBUTES`, its values in the file's
own frame; a change of axes goes into the object's matrix. If an attempt gives anything else, it is
removed, and the add-on shows its own points.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import bpy
from mathutils import Matrix

from .. import blender
from ..blender import delete, view_layer_of

FIRST_VERSION = (5, 3, 0)
ATTRIBUTES = {"position", "scale", "rotation", "radiance:base"}
UNCHANGED = {"forward_axis": "Y", "up_axis": "Z", "global_scale": 1.0, "use_scene_unit": False}
"""Options of the importer: no change of axes or units."""


def import_splats(path: Path) -> bpy.types.Object | None:
    """The PLY as an object of Blender's own splats; None if this Blender has none.

    The object is at the origin, in the collection that the importer puts it in.
    """
    if bpy.app.version < FIRST_VERSION:
        return None
    with _undisturbed() as possible:
        if not possible:
            return None
        before = set(bpy.data.objects)
        # No such operator, an error that it reports, or unknown options.
        with suppress(AttributeError, RuntimeError, TypeError):
            importer: Any = bpy.ops.wm
            importer.ply_import(filepath=str(path), **UNCHANGED)
        made = [item for item in bpy.data.objects if item not in before]
        if len(made) == 1 and _is_splats(made[0]):
            made[0].matrix_basis = Matrix()
            return made[0]
        for item in made:
            delete(item)
        return None


def _is_splats(item: bpy.types.Object) -> bool:
    attributes = {attribute.name for attribute in getattr(item.data, "attributes", ())}
    return item.type == "POINTCLOUD" and attributes >= ATTRIBUTES


@contextmanager
def _undisturbed() -> Iterator[bool]:
    """A context for the importer, after which the user's selection is as before.

    False if it cannot run, which is so outside object mode. The operator needs a window, and a
    timer has none of its own.
    """
    window = bpy.context.window or next(iter(blender.windows()), None)
    with bpy.context.temp_override(window=window):
        layer = view_layer_of(bpy.context)
        if bpy.context.mode != "OBJECT":
            yield False
            return
        active, selected = layer.objects.active, {o for o in layer.objects if o.select_get()}
        yield True
        for item in layer.objects:
            item.select_set(item in selected)
        layer.objects.active = active
