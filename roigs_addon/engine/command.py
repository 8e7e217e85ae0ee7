"""How to start the engine. No bpy."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

HIDDEN = 0x08000000 if os.name == "nt" else 0
"""Creation flags of every process that is started: CREATE_NO_WINDOW on Windows."""


ISOLATED = "-I"
"""Python's option: nothing is imported from the working folder or where variables lead."""


def variables() -> dict[str, str]:
    """This process's environment without Python's own variables.

    They lead another Python to Blender's packages, or to code that the user did not choose.
    """
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


@dataclass(frozen=True, kw_only=True)
class Engine:
    """The Python that runs the engine, and the folder that contains `roigs_engine`."""

    python: Path
    source: Path

    def command(self, arguments: Sequence[str]) -> list[str]:
        """The full command line of one engine command."""
        return [str(self.python), "-m", "roigs_engine", *arguments]

    def environment(self) -> dict[str, str]:
        """The variables of its process."""
        return variables() | {
            "PYTHONPATH": str(self.source),
            "PYTHONSAFEPATH": "1",  # no modules from the folder that Blender was started in
            "PYTHONUNBUFFERED": "1",
            "PYTHONUTF8": "1",
            "PYTHONNOUSERSITE": "1",
        }
