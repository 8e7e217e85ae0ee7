"""The Blender side of ROI-GS: the only code of the project that may import `bpy`.

It talks to the engine as to another program: a request file, JSON lines and a run folder
(docs/files.md); it imports nothing of `roigs_engine`.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

# Modules with `register()` and `unregister()`; a later one may use what an earlier one registered.
# They are imported then, so that the files that need no bpy can be used where there is none.
MODULES = (
    "preferences",
    "properties",
    "run_folders",
    "active_camera",
    "jobs",
    "operators.engine_setup",
    "operators.scene",
    "operators.regions",
    "operators.select",
    "operators.train",
    "operators.results",
    "viewport",
    "facts",
    "panels",
)


def register() -> None:
    """Register every module, in order; on a failure, what was registered is taken back."""
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
    """Unregister every module, last one first."""
    for name in reversed(MODULES):
        import_module(f".{name}", __package__).unregister()
