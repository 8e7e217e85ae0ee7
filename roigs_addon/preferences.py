"""The add-on's preferences: which Python runs the engine, and where it keeps things."""

from __future__ import annotations

import tempfile
import textwrap
from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from .engine import check, install, python
from .engine.client import Engine
from .errors import AddonError

# The extension's package, of which this one is a part; in tests it may stand alone.
ADDON = __package__.rpartition(".")[0] or __package__
LETTER = 7.5
"""Mean width of a letter, in pixels of an interface that is not scaled."""


class RoigsPreferences(bpy.types.AddonPreferences):
    """Edit ▸ Preferences ▸ Add-ons ▸ ROI-GS."""

    bl_idname = ADDON

    engine_python: StringProperty(
        name="Engine Python",
        subtype="FILE_PATH",
        description="Python that runs the engine (empty: found automatically)",
    )
    threads: IntProperty(
        name="Threads", default=0, min=0, description="CPU threads of the engine; 0: all"
    )
    device: EnumProperty(
        name="Train On",
        items=(
            ("auto", "Automatic", "The NVIDIA card where the engine can use one, else the CPU"),
            ("cpu", "CPU", "The CPU, whatever else there is"),
            ("cuda", "NVIDIA Card", "The card; an error where it cannot be used"),
        ),
        description="What the engine trains on",
    )
    cache: StringProperty(
        name="Cache Folder",
        subtype="DIR_PATH",
        description="For imported models and runs of unsaved files (empty: the user's folder)",
    )
    preview_seconds: FloatProperty(
        name="Preview Every",
        default=5.0,
        min=0.0,
        subtype="TIME_ABSOLUTE",
        description="Seconds between previews while training; 0: none",
    )
    cuda: BoolProperty(
        name="For NVIDIA Cards",
        description="Set up with the build of torch for CUDA: several gigabytes."
        " Training there needs NVIDIA's CUDA toolkit as well",
    )
    wheels: StringProperty(
        name="Folder of Wheels",
        subtype="DIR_PATH",
        description="Set up from the wheels in this folder, without a network (empty: from PyPI)",
    )

    def draw(self, context: bpy.types.Context) -> None:
        """The page in the preferences window."""
        layout = self.layout
        layout.use_property_split = True
        for name in ("engine_python", "device", "threads", "cache", "preview_seconds"):
            layout.prop(self, name)
        _draw_engine(layout.box().column())


def _draw_engine(layout: bpy.types.UILayout) -> None:
    """What the engine can do, and the way to set it up."""
    row = layout.row()
    row.label(text="Engine")
    row.operator("roigs.check_engine")
    for finding in check.last:
        _lines(layout, finding.text, "CHECKMARK" if finding.works else "ERROR")
    made = install.current
    if made is not None and not made.finished:
        row = layout.row(align=True)
        row.progress(factor=made.fraction, text=f"{made.title} {made.fraction:.0%}")
        row.operator("roigs.stop_setup", text="", icon="CANCEL")
        layout.label(text=made.line)
        return
    if made is not None:
        _lines(layout, made.message or made.title, "ERROR" if made.message else "CHECKMARK")
    settings = get()
    layout.prop(settings, "cuda")
    layout.prop(settings, "wheels")
    button = layout.operator("roigs.setup_engine", icon="IMPORT")
    button.cuda, button.wheels = settings.cuda, settings.wheels


def _lines(layout: bpy.types.UILayout, text: str, icon: str) -> None:
    """A text in lines that fit the page."""
    scale = bpy.context.preferences.system.ui_scale
    width = max(int(bpy.context.region.width * 0.7 / (LETTER * scale)), 30)
    column = layout.column(align=True)
    for number, line in enumerate(textwrap.wrap(text, width)):
        column.label(text=line, icon=icon if number == 0 else "BLANK1")


def get() -> RoigsPreferences | None:
    """The preferences; None when the package was registered without being an add-on."""
    addon = bpy.context.preferences.addons.get(ADDON)
    return addon.preferences if addon else None


# None of these folders need be there: whoever writes into one makes it.


def extension_folder() -> Path:
    """A folder that outlives updates of the extension; Blender removes it with the extension."""
    if ADDON.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(ADDON))
    return data_folder()


def data_folder() -> Path:
    """A folder of this user's that outlives the extension: for what cannot be made again."""
    base = bpy.utils.user_resource("DATAFILES", path="roigs")
    return Path(base) if base else Path(tempfile.gettempdir()) / "roigs"


def models_folder() -> Path:
    """Where imported models are kept."""
    return (_chosen_cache() or extension_folder() / "cache") / "models"


def unsaved_folder() -> Path:
    """Where runs of files that were never saved are kept."""
    return (_chosen_cache() or data_folder()) / "unsaved"


def _chosen_cache() -> Path | None:
    chosen = getattr(get(), "cache", "")
    return Path(bpy.path.abspath(chosen)) if chosen else None


def environments() -> Path:
    """Folder of the virtual environments that «Set up the engine» makes."""
    return extension_folder() / "engine"


def chosen_python() -> str:
    """The Python that the user named; empty to find one."""
    chosen = getattr(get(), "engine_python", "")
    return bpy.path.abspath(chosen) if chosen else ""


def engine(packages: tuple[str, ...]) -> Engine:
    """The engine, on a Python that has `packages`.

    Raises:
        AddonError: there is none.
    """
    found, reason = python.find(chosen_python(), environments(), packages)
    if found is None:
        raise AddonError(f"{reason} Set up the engine in the add-on's preferences.")
    return found


def register() -> None:
    """The class."""
    bpy.utils.register_class(RoigsPreferences)


def unregister() -> None:
    """Gone."""
    bpy.utils.unregister_class(RoigsPreferences)
