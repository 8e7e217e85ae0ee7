"""Step 5, Result: a picture of the 3D view with its Gaussians, like Viewport Render Image."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from .. import blender
from ..blender import registration, scene_of, view_3d_of
from ..errors import AddonError
from ..scene import lookup
from .base import available, failed

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ..blender import OperatorResult

IMAGE = "Viewport Render with Gaussians"


class RenderViewport(bpy.types.Operator):
    """Render an image of this 3D view with its Gaussians, in the size of a render"""

    bl_idname = "roigs.render_viewport"
    bl_label = "Viewport Render Image with Gaussians"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a 3D view with Gaussians in it."""
        inside = view_3d_of(context) is not None and context.region_data is not None
        if not inside or bpy.app.background:
            return available(cls, "Use it in a 3D view")
        return available(cls, "" if lookup.splats(scene_of(context)) else "Load results first")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Draw it, and show it as Blender shows renders."""
        from ..viewport.picture import view_picture  # builds things of the GPU

        try:
            image = _image(view_picture(context))
        except AddonError as error:
            return failed(self, error)
        except (RuntimeError, MemoryError, OSError) as error:
            return failed(self, f"There is no picture: {error}")
        _show(image)
        return {"FINISHED"}


def _image(pixels: NDArray[np.float32]) -> bpy.types.Image:
    """The picture as an image, in place of an earlier one that was not saved.

    It is that of a temporary file, as Blender 5 asks at each saving of the .blend whether images
    that were changed and not saved shall be.
    """
    path = os.path.join(bpy.app.tempdir, f"{IMAGE}.png")
    _write(pixels, path)
    image = next((i for i in bpy.data.images if _is_free(i, path)), None)
    if image is None:
        image = blender.load_image(Path(path))
        if image is None:
            raise AddonError(f"There is no picture: {path} cannot be read.")
        image.name = IMAGE
    else:
        image.reload()
    return image


def _write(pixels: NDArray[np.float32], path: str) -> None:
    height, width = pixels.shape[:2]
    image = bpy.data.images.new(IMAGE, width, height, alpha=True)
    try:
        values: Any = image.pixels
        values.foreach_set(pixels.ravel())
        image.filepath_raw, image.file_format = path, "PNG"
        image.save()
    finally:
        bpy.data.images.remove(image)


def _is_free(image: bpy.types.Image, path: str) -> bool:
    """Whether an image is the earlier picture: not saved elsewhere, and not packed."""
    return image.filepath == path and image.library is None and image.packed_file is None


def _show(image: bpy.types.Image) -> None:
    """In the place where Blender shows renders; its preferences say which."""
    bpy.ops.render.view_show("INVOKE_DEFAULT")
    for area in blender.areas("IMAGE_EDITOR"):
        space = area.spaces.active
        shown = isinstance(space, bpy.types.SpaceImageEditor) and space.image
        if (
            isinstance(space, bpy.types.SpaceImageEditor)
            and shown
            and shown.type == "RENDER_RESULT"
        ):
            space.image = image


def menu_entry(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """The entry in View, where there are Gaussians."""
    if menu.layout is not None and lookup.splats(scene_of(context)):
        menu.layout.separator()
        menu.layout.operator(RenderViewport.bl_idname, icon="RENDER_STILL")


register, unregister = registration(RenderViewport, menus={"VIEW3D_MT_view": menu_entry})
