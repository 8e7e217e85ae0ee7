"""The add-on's preferences: which Python runs the engine, and where it keeps things."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
from bpy.props import FloatProperty, IntProperty, StringProperty

from .engine import python
from .engine.client import Engine
from .errors import AddonError

# The extension's package, of which this one is a part; in tests it may stand alone.
ADDON = __package__.rpartition(".")[0] or __package__


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

    def draw(self, context: bpy.types.Context) -> None:
        """The page in the preferences window."""
        layout = self.layout
        layout.use_property_split = True
        for name in ("engine_python", "threads", "cache", "preview_seconds"):
            layout.prop(self, name)


def get() -> RoigsPreferences | None:
    """The preferences; None when the package was registered without being an add-on."""
    addon = bpy.context.preferences.addons.get(ADDON)
    return addon.preferences if addon else None


def user_folder() -> Path:
    """A folder of this user's that outlives updates of the extension."""
    if ADDON.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(ADDON, create=True))
    base = bpy.utils.user_resource("DATAFILES", path="roigs", create=True)
    return Path(base) if base else Path(tempfile.gettempdir()) / "roigs"


def cache_folder() -> Path:
    """Where imported models, and runs of files that were never saved, are kept."""
    chosen = getattr(get(), "cache", "")
    folder = Path(bpy.path.abspath(chosen)) if chosen else user_folder() / "cache"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def environment_folder() -> Path:
    """The virtual environment that «Set up the engine» makes."""
    return user_folder() / "engine"


def engine(packages: tuple[str, ...]) -> Engine:
    """The engine, on a Python that has `packages`.

    Raises:
        AddonError: there is none.
    """
    chosen = getattr(get(), "engine_python", "")
    found, reason = python.find(
        bpy.path.abspath(chosen) if chosen else "", environment_folder(), packages
    )
    if found is None:
        raise AddonError(f"{reason} Set up the engine in the add-on's preferences.")
    return found


def register() -> None:
    """The class."""
    bpy.utils.register_class(RoigsPreferences)


def unregister() -> None:
    """Gone."""
    bpy.utils.unregister_class(RoigsPreferences)
