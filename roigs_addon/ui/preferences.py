"""The preferences page: settings of the engine, folders, setting up the engine."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from .. import blender, settings
from ..blender import full_path, region_of, registration
from ..engine import check, install
from ..engine.event_log import DEVICE
from ..engine.graphics_card import Choice
from ..engine.install_steps import (
    CUDA_DOWNLOAD_BYTES,
    DISK_BYTES,
    DOWNLOAD_BYTES,
    FORMATS_DISK_BYTES,
    FORMATS_DOWNLOAD_BYTES,
)
from ..facts import graphics_card, training_device
from ..operators.engine_setup import BUILDS
from ..windows import redraw_sidebars
from .layout import PIXELS_PER_LETTER, draw_where, wrapped

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import IconItems


def _full_path(name: str) -> Callable[[RoigsPreferences, bpy.types.Context], None]:
    """What happens when a path is set: it is stored in full, and the sidebar looks again.

    Blender would store `//` for the folder of the open .blend, which means another one in the next.
    """

    def update(page: RoigsPreferences, _context: bpy.types.Context) -> None:
        path = getattr(page, name)
        if path.startswith("//") and bpy.data.filepath:
            setattr(page, name, str(full_path(path)))
        redraw_sidebars()

    return update


class RoigsPreferences(bpy.types.AddonPreferences):
    """Edit ▸ Preferences ▸ Add-ons ▸ ROI-GS; read through settings.py."""

    bl_idname = settings.ADDON

    engine_python: StringProperty(
        name="Engine Python",
        subtype="FILE_PATH",
        description="Python that runs the engine (empty: found automatically)",
        update=_full_path("engine_python"),
    )
    threads: IntProperty(
        name="Threads", default=0, min=0, description="CPU threads that the engine uses; 0: all"
    )
    device: EnumProperty(
        name="Device",
        items=(
            ("auto", "Automatic", "The NVIDIA GPU if the engine can use one, else the CPU"),
            ("cpu", "CPU", "Always the CPU"),
            ("cuda", "NVIDIA GPU", "The GPU; an error if it cannot be used"),
        ),
        description="The device that the engine trains on",
    )
    train_on: EnumProperty(
        name="Train On",
        items=(
            (settings.HERE, "This Computer", "The engine trains on this computer"),
            (settings.CLUSTER, "Cluster", "The engine sends the work to a Ray cluster"),
        ),
        description="Where to train",
    )
    cluster: StringProperty(
        name="Address",
        default=settings.NEAR,
        description="Of the Ray cluster: ray://HOST:10001, or auto for the one that this computer"
        " is part of. Its machines must see the photos and the run folder under the same paths",
    )
    cache: StringProperty(
        name="Cache Folder",
        subtype="DIR_PATH",
        description="For imported models and the runs of unsaved files (empty: the user's folder)",
        update=_full_path("cache"),
    )
    preview_seconds: FloatProperty(
        name="Preview Every",
        default=5.0,
        min=0.0,
        subtype="TIME_ABSOLUTE",
        description="Seconds between previews while training; 0: none",
    )
    build: EnumProperty(
        name="Build",
        items=BUILDS,
        description="Which torch to install. Training on a GPU needs only NVIDIA's driver besides",
    )
    formats: BoolProperty(
        name="File Formats",
        default=True,
        description="Also install the packages for SPZ, SOG, glTF, OpenUSD and web pages. PLY"
        " needs none",
    )
    wheels: StringProperty(
        name="Folder of Wheels",
        subtype="DIR_PATH",
        description="Install from the wheels in this folder, without a network (empty: from PyPI)",
        update=_full_path("wheels"),
    )

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the page in the preferences window."""
        layout = self.layout
        assert layout is not None
        layout.use_property_split = True
        for name in ("engine_python", "device", "threads"):
            layout.prop(self, name)
        draw_where(layout)
        for name in ("cache", "preview_seconds"):
            layout.prop(self, name)
        _draw_engine(layout.box().column(), self)


def _draw_engine(layout: bpy.types.UILayout, page: RoigsPreferences) -> None:
    """What the engine can do, and how to set it up."""
    row = layout.row()
    row.label(text="Engine")
    row.operator("roigs.check_engine")
    for finding in check.last:
        _lines(layout, finding.text, "CHECKMARK" if finding.works else "ERROR")
    if device := training_device.asked():
        _lines(layout, f"{DEVICE}{device}", "SYSTEM")
    made = install.current
    if made is not None and not made.finished:
        row = layout.row(align=True)
        row.progress(factor=made.fraction, text=f"{made.title} {made.fraction:.0%}")
        row.operator("roigs.stop_setup", text="", icon="CANCEL")
        layout.label(text=made.line)
        return
    if made is not None:
        _lines(layout, made.message or made.title, "ERROR" if made.message else "CHECKMARK")
    choice = graphics_card.choice()
    layout.prop(page, "build")
    layout.prop(page, "formats")
    layout.prop(page, "wheels")
    _lines(layout, _what_suits(choice), "INFO")
    _lines(layout, _needed_space(page, choice), "INFO")
    row = layout.row(align=True)
    button = row.operator("roigs.setup_engine", icon="IMPORT")
    button.build, button.formats, button.wheels = page.build, page.formats, page.wheels
    row.operator("roigs.remove_engine", icon="TRASH")


def _what_suits(choice: Choice | None) -> str:
    """What Automatic installs, and why."""
    if choice is None:
        return "Asking NVIDIA's driver …"
    what = "torch for the CPU" if choice.build is None else f"torch for CUDA ({choice.build.name})"
    return f"Automatic installs {what}. {choice.reason}"


def _needed_space(page: RoigsPreferences, choice: Choice | None) -> str:
    """What setting up takes, in words."""
    suits = choice is not None and choice.build is not None
    if page.build == "CUDA" or (page.build == "AUTO" and suits):
        size = f"{CUDA_DOWNLOAD_BYTES / 1e9:.1f}"
        return f"Downloads about {size} GB (on Linux), and takes more disk space."
    download, disk = DOWNLOAD_BYTES / 1e6, DISK_BYTES / 1e6
    if page.formats:
        download += FORMATS_DOWNLOAD_BYTES / 1e6
        disk += FORMATS_DISK_BYTES / 1e6
    return f"Downloads about {download:.0f} MB and takes {disk:.0f} MB of disk space (on Linux)."


def _lines(layout: bpy.types.UILayout, text: str, icon: IconItems) -> None:
    """A text, wrapped to fit the page."""
    scale = PIXELS_PER_LETTER * blender.interface_scale()
    wrapped(layout, text, icon, max(int(region_of(bpy.context).width * 0.7 / scale), 30))


register, unregister = registration(RoigsPreferences)
