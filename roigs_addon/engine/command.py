"""Command line that starts the engine. No bpy."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

HIDDEN = 0x08000000 if os.name == "nt" else 0
"""Creation flags of every process that is started: CREATE_NO_WINDOW on Windows."""


ISOLATED = "-I"
"""Python's option that ignores the working folder and environment variables for imports."""


SEARCHED = re.compile("PATH|LD_LIBRARY_PATH|DYLD_(FALLBACK_)?(LIBRARY|FRAMEWORK)_PATH")
"""Environment variables with search paths for programs and libraries."""


def variables() -> dict[str, str]:
    """Return this process's environment, without variables that could load untrusted code.

    Python's own variables would lead another Python to Blender's packages. In search paths, a
    relative entry is a folder below the working folder, where an untrusted .blend may be. An empty
    entry, as from `LD_LIBRARY_PATH=$LD_LIBRARY_PATH:/opt/lib`, is the working folder itself.
    """
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    found = {name: _full(kept[name]) for name in kept if SEARCHED.fullmatch(name.upper())}
    return {name: value for name, value in (kept | found).items() if value or name not in found}


def _full(folders: str) -> str:
    """Return a search path with only its absolute entries."""
    return os.pathsep.join(each for each in folders.split(os.pathsep) if os.path.isabs(each))


@dataclass(frozen=True, kw_only=True)
class Engine:
    """The Python that runs the engine, and the folder that contains `roigs_engine`."""

    python: Path
    source: Path

    def command(self, arguments: Sequence[str]) -> list[str]:
        """Return the full command line of one engine command."""
        return [str(self.python), "-m", "roigs_engine", *arguments]

    def environment(self) -> dict[str, str]:
        """Return the environment variables of the engine's process."""
        return variables() | {
            "PYTHONPATH": str(self.source),
            "PYTHONSAFEPATH": "1",  # no modules from the folder that Blender was started in
            "PYTHONUNBUFFERED": "1",
            "PYTHONUTF8": "1",
            "PYTHONNOUSERSITE": "1",
        }
