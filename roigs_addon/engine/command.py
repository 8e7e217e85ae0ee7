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
"""Python's option: nothing is imported from the working folder or where variables lead."""


SEARCHED = re.compile("PATH|LD_LIBRARY_PATH|DYLD_(FALLBACK_)?(LIBRARY|FRAMEWORK)_PATH")
"""Variables with folders in which systems look for programs and libraries."""


def variables() -> dict[str, str]:
    """This process's environment without what leads to code that the user did not choose.

    Python's own variables lead another Python to Blender's packages. In lists of folders, an entry
    that is no full path is one in the working folder, where a stranger's .blend may be; an empty
    one, as of `LD_LIBRARY_PATH=$LD_LIBRARY_PATH:/opt/lib`, is the working folder itself.
    """
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    found = {name: _full(kept[name]) for name in kept if SEARCHED.fullmatch(name.upper())}
    return {name: value for name, value in (kept | found).items() if value or name not in found}


def _full(folders: str) -> str:
    """The entries of a list of folders that are full paths."""
    return os.pathsep.join(each for each in folders.split(os.pathsep) if os.path.isabs(each))


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
