"""Blender's own Gaussian splats (5.3 and later), behind a probe of what its PLY importer makes.

No build of 5.3 was at hand when this was written. What is used here is what the importer's source
says: a 3DGS PLY becomes a point cloud object with the attributes of `ATTRIBUTES`, its values in the
file's own frame; the change of axes that the operator is asked for goes into the object's matrix.
Where that does not hold, nothing is kept of the attempt, and the add-on shows its own points.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import bpy
from mathutils import Matrix

FIRST_VERSION = (5, 3, 0)
ATTRIBUTES = {"position", "scale", "rotation", "radiance:base"}
AS_THEY_ARE = {"forward_axis": "Y", "up_axis": "Z", "global_scale": 1.0, "use_scene_unit": False}
"""Options of the importer: no change of axes or units."""


def import_splats(path: Path) -> bpy.types.Object | None:
    """The PLY as an object of Blender's own splats; None where Blender has none.

    The object is at the origin, in whatever collection the importer puts it.
    """
    if bpy.app.version < FIRST_VERSION:
        return None
    with _undisturbed() as possible:
        if not possible:
            return None
        before = set(bpy.data.objects)
        # No such operator, what it reports as an error, other options than are known.
        with suppress(AttributeError, RuntimeError, TypeError):
            bpy.ops.wm.ply_import(filepath=str(path), **AS_THEY_ARE)
        made = [item for item in bpy.data.objects if item not in before]
        if len(made) == 1 and _is_splats(made[0]):
            made[0].matrix_basis = Matrix()
            return made[0]
        for item in made:
            _remove(item)
        return None


def _is_splats(item: bpy.types.Object) -> bool:
    attributes = {attribute.name for attribute in getattr(item.data, "attributes", ())}
    return item.type == "POINTCLOUD" and attributes >= ATTRIBUTES


def _remove(item: bpy.types.Object) -> None:
    data = item.data
    bpy.data.objects.remove(item)
    if data is not None and not data.users:
        bpy.data.batch_remove([data])


@contextmanager
def _undisturbed() -> Iterator[bool]:
    """Run the importer inside: the user's selection comes back after it.

    False where it cannot run: outside of object mode. A timer has no window of its own, which the
    operator asks for.
    """
    windows = bpy.context.window_manager.windows
    window = bpy.context.window or next(iter(windows), None)
    with bpy.context.temp_override(window=window):
        layer = bpy.context.view_layer
        if bpy.context.mode != "OBJECT":
            yield False
            return
        active, selected = layer.objects.active, {o for o in layer.objects if o.select_get()}
        yield True
        for item in layer.objects:
            item.select_set(item in selected)
        layer.objects.active = active
