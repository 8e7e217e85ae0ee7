"""Handles on the faces of the active box in the 3D view, to drag each face."""

from __future__ import annotations

from typing import Any

import bpy

from ..blender import registration, view_3d_of
from ..operators.box_tools import MoveFace
from ..properties import object_props
from ..scene import box_faces
from ..scene.box_faces import Face

FACES: tuple[Face, ...] = tuple((axis, sign) for axis in range(3) for sign in (1, -1))
COLOURS = ((0.96, 0.21, 0.32), (0.54, 0.86, 0.0), (0.16, 0.55, 0.96))
"""Colours of the axes, as in Blender's themes."""
LENGTH, ALPHA = 0.35, 0.7


class BoxHandles(bpy.types.GizmoGroup):
    """An arrow on each face."""

    bl_idname = "ROIGS_GGT_box_handles"
    bl_label = "Faces of the Box"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options = {"3D", "PERSISTENT", "SHOW_MODAL_ALL"}

    _arrows: list[Any]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The active object must be a box that is selected and visible, in object mode."""
        item, space = context.active_object, view_3d_of(context)
        if item is None or space is None or context.mode != "OBJECT":
            return False
        seen = item.select_get() and item.visible_get(viewport=space)
        return bool(object_props(item).kind == "ROI" and seen)

    def setup(self, context: bpy.types.Context) -> None:
        """Make the arrows."""
        self._arrows = []
        for axis, sign in FACES:
            arrow: Any = self.gizmos.new("GIZMO_GT_arrow_3d")
            arrow.draw_style, arrow.length = "BOX", LENGTH
            arrow.color, arrow.alpha = COLOURS[axis], ALPHA
            arrow.color_highlight, arrow.alpha_highlight = (1.0, 1.0, 1.0), 1.0
            operator = arrow.target_set_operator(MoveFace.bl_idname)
            operator.axis, operator.sign = axis, sign
            self._arrows.append(arrow)

    def draw_prepare(self, context: bpy.types.Context) -> None:
        """Put the arrows where the faces are now."""
        item = context.active_object
        if item is not None and object_props(item).kind == "ROI":
            for arrow, face in zip(self._arrows, FACES, strict=True):
                arrow.matrix_basis = box_faces.face_matrix(item, face)


register, unregister = registration(BoxHandles)
