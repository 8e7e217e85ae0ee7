"""The user's settings of the add-on, and the folders derived from them.

They are edited on the preferences page (ui/preferences.py). If the package is registered without
being an add-on, as in tests, the defaults apply.
"""

from __future__ import annotations

import re
import tempfile
from dataclasses import dataclass, fields
from pathlib import Path

import bpy

from . import blender
from .engine import python
from .engine.command import Engine
from .errors import AddonError

# The extension's package, of which this one is a part; in tests this one may stand alone.
ADDON = (__package__ or "").rpartition(".")[0] or __package__ or ""


HERE, CLUSTER = "HERE", "CLUSTER"
"""Where the engine trains."""
NEAR = "auto"
"""Address of the cluster that this computer is part of."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The values of the preferences page; their meaning is described there."""

    engine_python: str = ""
    threads: int = 0
    device: str = "auto"
    train_on: str = HERE
    cluster: str = NEAR
    cache: str = ""
    preview_seconds: float = 5.0
    build: str = "AUTO"
    formats: bool = True
    wheels: str = ""


def page() -> bpy.types.AddonPreferences | None:
    """The preferences page; None where the package is no add-on."""
    addon = blender.preferences().addons.get(ADDON)
    return addon.preferences if addon else None


def get() -> Settings:
    """The settings as they are now."""
    found = page()
    if found is None:
        return Settings()
    return Settings(**{field.name: getattr(found, field.name) for field in fields(Settings)})


def cluster() -> str:
    """The address of the cluster that trains; empty: this computer does.

    It is the user's, not the .blend's: whoever runs a cluster can run programs here.
    """
    chosen = get()
    return (chosen.cluster.strip() or NEAR) if chosen.train_on == CLUSTER else ""


# None of these folders need exist: whoever writes into one creates it.


def extension_folder() -> Path:
    """A folder that outlives updates of the extension; Blender removes it with the extension."""
    if ADDON.startswith("bl_ext."):
        return Path(bpy.utils.extension_path_user(ADDON))
    return data_folder()


def data_folder() -> Path:
    """A folder of the user's that outlives the extension, for what cannot be made again."""
    base = bpy.utils.user_resource("DATAFILES", path="roigs")
    return Path(base) if base else Path(tempfile.gettempdir()) / "roigs"


def models_folder() -> Path:
    """The folder of imported models."""
    return (_chosen_cache() or extension_folder() / "cache") / "models"


def pictures_folder() -> Path:
    """The folder of photos as training sees them."""
    return (_chosen_cache() or extension_folder() / "cache") / "photos"


def unsaved_folder() -> Path:
    """The folder of runs of unsaved files."""
    return (_chosen_cache() or data_folder()) / "unsaved"


def environments() -> tuple[Path, ...]:
    """Folders of the virtual environments that 'Set Up the Engine' makes, the first one now.

    It is beside the folders of Blender's versions, which share it, and outlives the extension. In
    the second one, earlier versions of the add-on made them.
    """
    user = Path(bpy.utils.resource_path("USER") or data_folder())
    beside = user.parent if re.fullmatch(r"\d+\.\d+", user.name) else user
    return beside / "roigs" / "engine", extension_folder() / "engine"


def chosen_python() -> str:
    """The Python that the user named; empty to find one."""
    return get().engine_python


def engine(packages: tuple[str, ...]) -> Engine:
    """The engine, on a Python that has `packages`.

    Raises:
        AddonError: there is none.
    """
    chosen = chosen_python()
    found, reason = python.find(chosen, environments(), packages)
    if found is None:
        remedy = "Change or clear Engine Python" if chosen else "Set up the engine"
        raise AddonError(f"{reason} {remedy} in the add-on's preferences.")
    return found


def _chosen_cache() -> Path | None:
    chosen = get().cache
    return Path(chosen) if chosen and not chosen.startswith("//") else None
