"""The Blender side of ROI-GS: the only code of the project that may import `bpy`.

It talks to the engine as to another program, through options files, JSON lines and a run folder
(docs/files.md). Of `roigs_engine` it imports only the formats and their errors, through
`shared.py`. A package imports only from those above it:

| package | contents |
|---|---|
| `geometry/` | cameras and boxes in COLMAP's frame and in Blender's; no bpy |
| `engine/` | the engine as another program: runs, finds, installs it, reads its runs; no bpy |
| `scene/` | COLMAP models, boxes and Gaussians as Blender objects |
| `jobs/` | the one engine job at a time, and its request |
| `facts/` | data for panels and buttons, cached |
| `viewport/` | Gaussians, points and boxes drawn in the 3D view |
| `operators/` | the user's actions |
| `ui/` | the sidebar and the preferences page |
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

# Modules with `register()` and `unregister()`; a later one may use what an earlier one registered.
# They are imported only then, so that files without bpy can be used where there is none.
MODULES = (
    "ui.preferences",
    "properties",
    "jobs.run_folders",
    "scene.active_camera",
    "scene.backgrounds",
    "scene.edits",
    "scene.heat_map",
    "scene.box_surfaces",
    "scene.carried",
    "scene.instances",
    "scene.ownership",
    "scene.formerly_hidden",
    "scene.arrivals",
    "scene.placement",
    "jobs.current",
    "operators.engine_setup",
    "operators.reconstruct",
    "operators.drop",
    "operators.scene",
    "operators.placement",
    "operators.boxes",
    "operators.box_tools",
    "operators.photos",
    "operators.suggest",
    "operators.scribble",
    "operators.masks",
    "operators.train",
    "operators.results",
    "operators.look",
    "operators.click",
    "operators.levels",
    "operators.surface",
    "operators.stage",
    "operators.stand_here",
    "operators.relight",
    "operators.adapt",
    "operators.run_folder",
    "operators.export",
    "operators.import_gaussians",
    "operators.clean_up",
    "operators.floaters",
    "operators.confidence",
    "operators.erase_brush",
    "operators.native_splats",
    "operators.viewport_render",
    "viewport",
    "rendering",
    "facts.caches",
    "ui.set_up",
    "ui.reconstruct",
    "ui.scene",
    "ui.placement",
    "ui.boxes",
    "ui.box_handles",
    "ui.wipe_handle",
    "ui.cameras",
    "ui.suggestions",
    "ui.selected",
    "ui.masks",
    "ui.train",
    "ui.result",
    "ui.look",
    "ui.clean_up",
    "ui.surface",
    "ui.stage",
    "ui.relight",
    "ui.levels",
)


def register() -> None:
    """Register every module, in order; if one fails, unregister those before it."""
    done: list[ModuleType] = []
    try:
        for name in MODULES:
            module = import_module(f".{name}", __package__)
            module.register()
            done.append(module)
    except Exception:
        for module in reversed(done):
            module.unregister()
        raise


def unregister() -> None:
    """Unregister every module, the last one first."""
    for name in reversed(MODULES):
        import_module(f".{name}", __package__).unregister()
