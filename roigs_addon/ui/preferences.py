"""The preferences page: the engine's set-up, settings and folders."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from .. import blender, settings
from ..blender import full_path, region_of, registration
from ..engine import check, install
from ..engine.graphics_card import Choice
from ..engine.install_steps import (
    CUDA_DOWNLOAD_BYTES,
    DISK_BYTES,
    DOWNLOAD_BYTES,
    FORMATS_DISK_BYTES,
    FORMATS_DOWNLOAD_BYTES,
)
from ..facts import graphics_card, training_device
from ..operators.engine_setup import BUILDS, OFFLINE
from ..properties import zero
from ..windows import redraw_sidebars
from .layout import PIXELS_PER_LETTER, draw_where, or_number, wrapped

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import IconItems


PURPOSE = "Training and rendering need the engine, a separate program. Set it up once"
NEXT = "Next: open the sidebar of a 3D view (N), tab ROI-GS"


def _full_path(name: str) -> Callable[[RoigsPreferences, bpy.types.Context], None]:
    """Return an update function that stores a path in full and updates the sidebar.

    Blender would store `//` for the folder of the open .blend, which means another folder in the
    next .blend.
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
        description="Python program that runs the engine (empty: found automatically)",
        update=_full_path("engine_python"),
    )
    threads: IntProperty(
        name="Threads", default=0, min=0, description="CPU threads of the engine; 0: all"
    )
    device: EnumProperty(
        name="Device",
        items=(
            ("auto", "Automatic", "The GPU if it works and is faster, otherwise the CPU"),
            ("cpu", "CPU", "Always the CPU"),
            ("cuda", "NVIDIA GPU", "The GPU; an error if it cannot be used"),
            ("gpu", "Other GPU", "A GPU through Vulkan or Metal; an error if it cannot be used"),
        ),
        description="Device for training",
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
        description="Address of the Ray cluster: ray://HOST:10001, or auto if this computer is part"
        " of it. All its machines must see the photos and the run folder under the same paths",
    )
    cache: StringProperty(
        name="Cache Folder",
        subtype="DIR_PATH",
        description="For imported models and the runs of unsaved files (empty: in your account)",
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
        description="Build of torch to install. A GPU also needs NVIDIA's driver",
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
        description="Folder of Python packages (.whl) to install from, without a network (empty:"
        " download them)",
        update=_full_path("wheels"),
    )

    all_threads: zero("threads", 4, name="All", description="Use all of the processor's threads")
    advanced: BoolProperty(name="Advanced", description="Show rarely needed settings")

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the page in the preferences window."""
        layout = self.layout
        assert layout is not None
        _draw_engine(layout.box().column(), self)
        layout.use_property_split = True
        layout.prop(self, "device")
        layout.prop(self, "preview_seconds")
        row = layout.row()
        row.use_property_split, row.alignment = False, "LEFT"
        icon: IconItems = "DISCLOSURE_TRI_DOWN" if self.advanced else "DISCLOSURE_TRI_RIGHT"
        row.prop(self, "advanced", icon=icon, emboss=False)
        if self.advanced:
            for name in ("engine_python", "build", "formats", "wheels", "cache"):
                layout.prop(self, name)
            or_number(layout, self, "Threads", "all_threads", "threads")
            draw_where(layout)


def _draw_engine(layout: bpy.types.UILayout, page: RoigsPreferences) -> None:
    """Show the set-up of the engine, and its abilities."""
    made = install.current
    if made is not None and not made.finished:
        row = layout.row(align=True)
        row.progress(factor=made.fraction, text=f"{made.title} {made.fraction:.0%}")
        row.operator("roigs.stop_setup", text="", icon="CANCEL")
        layout.label(text=made.line)
        return
    choice = graphics_card.choice()
    _lines(layout, PURPOSE, "INFO")
    if page.build == "AUTO":
        _lines(layout, _what_suits(choice), "BLANK1")
    _lines(layout, _needed_space(page, choice), "BLANK1")
    offline = not (page.wheels or bpy.app.online_access)
    if offline:
        _draw_offline(layout)
    row = layout.row(align=True)
    main = row.row(align=True)
    main.scale_y, main.enabled = 1.5, not offline
    button = main.operator("roigs.setup_engine", icon="IMPORT")
    button.build, button.formats, button.wheels = page.build, page.formats, page.wheels
    others = row.row(align=True)
    others.scale_y = 1.5
    others.operator("roigs.check_engine")
    others.operator("roigs.remove_engine", icon="TRASH")
    if made is not None and made.message:
        _lines(layout, made.message, "ERROR")
    elif made is not None:
        _lines(layout, f"{made.title}. {NEXT}", "CHECKMARK")
    for finding in check.last:
        _lines(layout, finding.text, "CHECKMARK" if finding.works else "ERROR")
    if device := training_device.asked():
        _lines(layout, training_device.in_words(device), "SYSTEM")


def _draw_offline(layout: bpy.types.UILayout) -> None:
    """Show Blender's own switch for the network, unless the command line has locked it."""
    _lines(layout, OFFLINE, "ERROR")
    if not bpy.app.online_access_override:
        layout.prop(blender.preferences().system, "use_online_access")


def _what_suits(choice: Choice | None) -> str:
    """Describe the build that **Automatic** installs, and the reason."""
    if choice is None:
        return "Asking NVIDIA's driver …"
    what = "torch for the CPU" if choice.build is None else f"torch for CUDA ({choice.build.name})"
    return f"Automatic installs {what}. {choice.reason}"


def _needed_space(page: RoigsPreferences, choice: Choice | None) -> str:
    """Describe the download size and disk space of the set-up."""
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
    """Show a text, wrapped to fit the page."""
    scale = PIXELS_PER_LETTER * blender.interface_scale()
    wrapped(layout, text, icon, max(int(region_of(bpy.context).width * 0.7 / scale), 30))


register, unregister = registration(RoigsPreferences)
