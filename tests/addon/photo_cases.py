"""Photos to reconstruct, and what the add-on says of them."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.scenes import ROOT

WIDE = ROOT / "demo" / "scene" / "images" / "wide"
SIDE = 320
"""px; small, so that a test takes seconds."""


def photos_in(folder: Path, count: int) -> Path:
    """A folder with some of the demo's photos, neighbours of one another."""
    folder.mkdir(parents=True)
    for path in sorted(WIDE.iterdir())[:count]:
        shutil.copyfile(path, folder / path.name)
    return folder


def panel(bpy: ModuleType) -> str:
    from roigs_addon.ui.reconstruct import PhotosPanel
    from tests.addon.panels import said

    return " ".join(said(bpy, PhotosPanel))


def is_shown(bpy: ModuleType) -> bool:
    from roigs_addon.ui.reconstruct import PhotosPanel

    return PhotosPanel.poll(bpy.context)


def refusal(bpy: ModuleType, **values: str) -> str:
    """The error of a reconstruction that fails; one line."""
    with pytest.raises(RuntimeError) as error:
        bpy.ops.roigs.reconstruct(**values)
    text = str(error.value).strip().removeprefix("Error: ")
    assert "\n" not in text and "Traceback" not in text
    return text
