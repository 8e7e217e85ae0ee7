"""The Blender side of ROI-GS: the only code of the project that may import `bpy`.

It talks to the engine as to another program: a request file, JSON lines and a run folder
(docs/files.md); it imports nothing of `roigs_engine`.
"""

from __future__ import annotations

from types import ModuleType

from . import jobs, panels, preferences, properties, viewport
from .operators import OPERATORS

# Modules with `register()` and `unregister()`; a later one may use what an earlier one registered.
MODULES: tuple[ModuleType, ...] = (
    preferences,
    properties,
    jobs,
    *OPERATORS,
    viewport,
    panels,
)


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
