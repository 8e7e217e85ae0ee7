"""How to start the engine. No bpy."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

HIDDEN = 0x08000000 if os.name == "nt" else 0
"""Creation flags of every process that is started: CREATE_NO_WINDOW on Windows."""


def without_blender(variables: Mapping[str, str]) -> dict[str, str]:
    """Environment variables without those that lead another Python to Blender's packages."""
    return {k: v for k, v in variables.items() if k not in ("PYTHONHOME", "PYTHONPATH")}


@dataclass(frozen=True, kw_only=True)
class Engine:
    """The Python that runs the engine, and the folder that contains `roigs_engine`."""

    python: Path
    source: Path

    def command(self, arguments: Sequence[str]) -> list[str]:
        """The full command line of one engine command."""
        return [str(self.python), "-m", "roigs_engine", *arguments]

    def environment(self) -> dict[str, str]:
        """This process's variables, without what belongs to Blender's own Python."""
        return without_blender(os.environ) | {
            "PYTHONPATH": str(self.source),
            "PYTHONSAFEPATH": "1",  # no modules from the folder that Blender was started in
            "PYTHONUNBUFFERED": "1",
            "PYTHONUTF8": "1",
            "PYTHONNOUSERSITE": "1",
        }
