"""The Blender side of ROI-GS: the only code of the project that may import `bpy`.

It will hold, one module each and registered in this order: preferences (the engine's Python),
properties, operators (import a COLMAP scene, add a box, select photos, train, bring results back),
the viewport's draw handler, and panels. It talks to the engine as to another program: a request
file, JSON lines and a run folder (docs/files.md); it imports nothing of `roigs_engine`.
"""

from __future__ import annotations

from types import ModuleType

# Modules with `register()` and `unregister()`; a later one may use what an earlier one registered.
MODULES: tuple[ModuleType, ...] = ()


def register() -> None:
    """Register every module, in order; on a failure, what was registered is taken back."""
    done: list[ModuleType] = []
    try:
        for module in MODULES:
            module.register()
            done.append(module)
    except Exception:
        for module in reversed(done):
            module.unregister()
        raise


def unregister() -> None:
    """Unregister every module, last one first."""
    for module in reversed(MODULES):
        module.unregister()
