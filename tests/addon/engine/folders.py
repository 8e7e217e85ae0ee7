"""Files of run folders, and a process that holds their lock."""

from __future__ import annotations

from pathlib import Path

HOLD = """
import sys
from pathlib import Path
from roigs_engine.formats.lock import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def write(path: Path, text: str = "{}") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
