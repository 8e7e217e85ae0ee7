"""Blender's own Gaussian splats (5.3 and later), behind a probe of what its PLY importer makes.

No build of 5.3 was at hand when this was written: what is used here is only that the importer reads
a 3DGS PLY into a point cloud with radiance attributes. Where that does not hold, nothing is kept of
the attempt, and the add-on shows its own points and drawing.
"""

from __future__ import annotations

from pathlib import Path

import bpy

FIRST_VERSION = (5, 3, 0)
RADIANCE = "radiance"  # what the names of a splat's colour attributes begin with


def import_splats(path: Path) -> bpy.types.Object | None:
    """The PLY as an object of Blender's own splats; None where Blender has none.

    The object is in whatever collection the importer puts it.
    """
    if bpy.app.version < FIRST_VERSION:
        return None
    before = set(bpy.data.objects)
    try:
        bpy.ops.wm.ply_import(filepath=str(path))
    except (AttributeError, RuntimeError):
        return None
    made = [item for item in bpy.data.objects if item not in before]
    if len(made) == 1 and _is_splats(made[0]):
        return made[0]
    for item in made:
        bpy.data.objects.remove(item)
    return None


def _is_splats(item: bpy.types.Object) -> bool:
    attributes = getattr(item.data, "attributes", ())
    return item.type == "POINTCLOUD" and any(a.name.startswith(RADIANCE) for a in attributes)
