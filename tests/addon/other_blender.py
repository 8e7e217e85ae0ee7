"""A second Blender with its own engine, for a test to kill."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from roigs_addon.engine.python import VARIABLE


def other_blender(folder: Path, code: str) -> subprocess.Popen[str]:
    """Another Blender like this one that runs a script."""
    import bpy

    script = folder / "script.py"
    script.write_text(code, encoding="utf-8")
    command = [sys.executable, str(script)]
    program = bpy.app.binary_path and (os.environ.get("ROIGS_BLENDER") or bpy.app.binary_path)
    if program:
        command = [program, "-b", "--factory-startup", "--python", str(script)]
    environment = {**os.environ, VARIABLE: os.environ.get(VARIABLE) or sys.executable}
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment
    )


def engine_pid(process: subprocess.Popen[str], title: str) -> int:
    """The engine that the other Blender started for a job of this title."""
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(f"PID {title}"):
            return int(line.split()[-1])
    raise AssertionError("the other Blender did not start the engine")
