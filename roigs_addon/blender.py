"""Blender's own data with exact types.

Blender's stubs say that almost everything in a context may be None, and that an object's data may
be of any kind. The functions here have exact types for cases in which it is known.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

import bpy

from .errors import AddonError

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import OperatorReturnItems

    OperatorResult = set[OperatorReturnItems]

Registration = Callable[[], None]
MenuEntry = Callable[[bpy.types.Menu, bpy.types.Context], None]
Handler = TypeVar("Handler", bound=Callable[..., None])


def scene_of(context: bpy.types.Context) -> bpy.types.Scene:
    """The scene of a context; there is always one where an operator or a panel runs."""
    assert context.scene is not None
    return context.scene


def view_layer_of(context: bpy.types.Context) -> bpy.types.ViewLayer:
    """The view layer of a context; likewise."""
    assert context.view_layer is not None
    return context.view_layer


def region_of(context: bpy.types.Context) -> bpy.types.Region:
    """The region that is being drawn."""
    assert context.region is not None
    return context.region


def region_view_of(context: bpy.types.Context) -> bpy.types.RegionView3D:
    """The view of the 3D region that is being drawn."""
    assert context.region_data is not None
    return context.region_data


def view_3d_of(context: bpy.types.Context) -> bpy.types.SpaceView3D | None:
    """The 3D view of a context, if it is in one."""
    space = context.space_data
    return space if isinstance(space, bpy.types.SpaceView3D) else None


def layout_of(panel: bpy.types.Panel | bpy.types.Operator) -> bpy.types.UILayout:
    """The layout of a panel, or of an operator's settings, while it is drawn."""
    assert panel.layout is not None
    return panel.layout


def preferences() -> bpy.types.Preferences:
    """The user's preferences."""
    assert bpy.context.preferences is not None
    return bpy.context.preferences


def interface_scale() -> float:
    """Scale of the interface relative to the usual one."""
    return float(preferences().system.ui_scale)


def windows() -> list[bpy.types.Window]:
    """All of Blender's windows; none in background mode, or while a file is loaded."""
    manager = bpy.context.window_manager
    return list(manager.windows) if manager is not None else []


def areas(kind: str) -> Iterator[bpy.types.Area]:
    """The areas of a kind, in all windows."""
    for window in windows():
        yield from (area for area in window.screen.areas if area.type == kind)


def is_local(block: bpy.types.ID) -> bool:
    """Whether a data-block is this .blend's own: neither linked nor a library override."""
    return block.library is None and block.override_library is None


def mesh_of(item: bpy.types.Object) -> bpy.types.Mesh:
    """The mesh of a mesh object."""
    assert isinstance(item.data, bpy.types.Mesh)
    return item.data


def camera_of(item: bpy.types.Object) -> bpy.types.Camera:
    """The data of a camera object."""
    assert isinstance(item.data, bpy.types.Camera)
    return item.data


def absolute(path: str) -> Path:
    """The file or folder of a property, in full.

    Raises:
        AddonError: it is beside a .blend that has never been saved.
    """
    if path.startswith("//") and not bpy.data.filepath:
        raise AddonError(f"{path} is beside this .blend. Save the .blend first.")
    return full_path(path)


def stored(path: str) -> Path:
    """The file or folder that a .blend names, in full; as `absolute`.

    Raises:
        AddonError: also if the path is of another system, or no full one: it would be in the
            folder that Blender was started in.
    """
    full = absolute(path)
    if path and not os.path.isabs(bpy.path.abspath(path)):
        raise AddonError(f"{path} is not a full path on this computer. Choose it again.")
    return full


def full_path(path: str) -> Path:
    """The same without the check, for what may not fail."""
    return Path(os.path.abspath(bpy.path.abspath(path)))


def is_plain_file(path: str | Path) -> bool:
    """Whether a path leads to a file that can be opened without waiting: no pipe, no device."""
    try:
        return stat.S_ISREG(os.stat(path).st_mode)
    except (OSError, ValueError):  # ValueError: a NUL in it
        return False


def load_image(path: Path, *, check_existing: bool = False) -> bpy.types.Image | None:
    """A picture of a file as an image of Blender's; None if it is none, or not to be opened.

    Blender itself would wait for a pipe for ever.
    """
    if not is_plain_file(path):
        return None
    try:
        return bpy.data.images.load(str(path), check_existing=check_existing)
    except (RuntimeError, UnicodeError):  # missing, no picture, or a name that is no text
        return None


def delete(item: bpy.types.Object) -> None:
    """Delete an object, and its data if nothing else uses it."""
    data = item.data
    bpy.data.objects.remove(item)
    if data is not None and not data.users:
        bpy.data.batch_remove([data])


def leave_edit_mode(items: Iterable[bpy.types.Object]) -> None:
    """Put objects whose data is about to be replaced into object mode, in all windows.

    In another mode Blender holds a copy of the data, and would write it into the new one.
    """
    if all(item.mode == "OBJECT" for item in items):
        return
    places: list[bpy.types.Window | None] = [*windows()]
    for window in places or [None]:
        with bpy.context.temp_override(window=window):
            if bpy.context.mode != "OBJECT":
                bpy.ops.object.mode_set(mode="OBJECT")


def select_only(context: bpy.types.Context, item: bpy.types.Object) -> None:
    """Select an object and nothing else, unless its collection is excluded from the view layer.

    Edit mode ends before: Blender would keep it for an object that is no longer the active one.
    """
    if context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    objects = view_layer_of(context).objects
    for other in list(objects.selected):
        other.select_set(False)
    with suppress(RuntimeError):
        item.select_set(True)
        objects.active = item


def is_rendering() -> bool:
    """Whether Blender renders in a thread of its own, from a window: its data must not change."""
    app: Any = bpy.app
    return bool(app.is_job_running("RENDER"))


def persistent(handler: Handler) -> Handler:
    """Have Blender keep a handler when another file is loaded."""
    kept: Handler = bpy.app.handlers.persistent(handler)
    return kept


def following(*handlers: tuple[str, Handler]) -> tuple[Registration, Registration]:
    """Functions that add and remove handlers, each with Blender's name of its event."""

    def follow() -> None:
        for event, handler in handlers:
            getattr(bpy.app.handlers, event).append(handler)

    def leave() -> None:
        for event, handler in handlers:
            getattr(bpy.app.handlers, event).remove(handler)

    return follow, leave


def registration(
    *classes: type, menus: Mapping[str, MenuEntry] = MappingProxyType({})
) -> tuple[Registration, Registration]:
    """`register` and `unregister` of a module with these classes.

    Args:
        classes: of Blender's types.
        menus: Blender's menu -> what draws an entry at its end.
    """

    def register() -> None:
        for cls in classes:
            bpy.utils.register_class(cls)
        for menu, entry in menus.items():
            getattr(bpy.types, menu).append(entry)

    def unregister() -> None:
        for menu, entry in menus.items():
            getattr(bpy.types, menu).remove(entry)
        for cls in reversed(classes):
            bpy.utils.unregister_class(cls)

    return register, unregister
