"""Family: commands and their children in a folder with hostile modules and programs.

Whatever of it runs leaves a file in the case's folder, which is found as one that is written
outside. Each case starts processes.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

from roigs_addon.engine import base_python, graphics_card, programs, python
from roigs_engine.app.outputs import Result
from roigs_engine.batch.engine_process import DONE, run_engine
from roigs_engine.context import QUIET, Context
from roigs_engine.errors import EngineError
from roigs_engine.machine import child_environment
from roigs_engine.reconstruction.child import run_task
from roigs_engine.requests.declare import Request, option
from roigs_engine.requests.values import PATH
from tests.fuzz.cases import Case, good_boxes, good_scene, write

ROOT = Path(__file__).resolve().parents[2]
MODULES = (
    *("numpy", "PIL", "torch", "pycolmap", "json", "argparse", "typing", "dataclasses", "pathlib"),
    *("sitecustomize", "usercustomize", "venv", "pip", "ensurepip", "ziglang", "scipy", "ctypes"),
    *("tomllib", "signal", "hashlib", "subprocess", "tempfile", "encodings", "_thread", "fsspec"),
)
PROGRAMS = ("python3", "python3.11", "nvidia-smi", "zig", "c++", "g++", "ffmpeg", "colmap", "py")
COMMANDS = ("inspect", "export", "select")
OTHERS = ("kernels.build", "engine of a batch", "worker", "child", "add-on", "set-up")


@dataclass(frozen=True, kw_only=True)
class Beside(Request):
    """A folder, and what is started there."""

    folder: Path = option(PATH, "folder", required=True, flags=())


def start(words: Sequence[str], **more: Any) -> None:
    """Start Python's words here, as from a shell; AssertionError if that fails."""
    found = os.environ | {"PYTHONPATH": str(ROOT)} | more
    done = subprocess.run([sys.executable, *words], capture_output=True, env=found, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


def beside(request: Any, context: Context) -> Result:
    """Do what the folder's file `what` says, in that folder."""
    folder = request.folder
    out, scene = folder.parent.parent / "out", folder.parent
    asked, *words = (folder / "what").read_text(encoding="utf-8").splitlines()
    before = Path.cwd()
    os.chdir(folder)
    try:
        with mock.patch.dict(os.environ):
            os.environ.pop("PYTHONSAFEPATH", None)
            os.environ["PATH"] = os.pathsep.join(["", ".", os.environ["PATH"]])
            if asked in COMMANDS:
                start(["-m", "roigs_engine", asked, *words])
            elif asked == "kernels.build":
                start(["-m", "roigs_engine.kernels.build", "--help"])
            elif asked == "engine of a batch":
                os.environ["PYTHONPATH"] = os.pathsep.join(["", ".", str(ROOT)])
                said = run_engine(["inspect", str(scene)], lambda event: None, lambda: False)
                assert said.state == DONE, said
            elif asked == "child":
                out.mkdir(exist_ok=True)
                with suppress(EngineError):
                    run_task({"work": "nothing", "database": "x"}, out / "log", QUIET)
            elif asked == "worker":
                code = "import roigs_engine.reconstruction.worker, numpy, PIL.Image"
                start(["-c", code], **child_environment())
            else:
                os.environ["PYTHONPATH"] = str(folder)
                python.ability.cache_clear()
                assert not python.ability(Path(sys.executable)).fault
                for command in base_python._pythons():
                    base_python._version(command)
                for program in PROGRAMS:
                    programs.find_program(program)
                graphics_card.find()
    finally:
        os.chdir(before)
    return Result()


def working_folders(dice: random.Random, folder: Path) -> Case:
    """Every entry point and child process, beside modules and programs of a stranger's."""
    scene, out = good_scene(folder), str(folder / "out")
    place, left = folder / "in" / "work", folder / "left"
    for name in dice.sample(MODULES, dice.randint(3, len(MODULES))):
        leave = f"open({str(left)!r}, 'a').write({name!r})\n"
        write(place / dice.choice((f"{name}.py", f"{name}/__init__.py")), leave)
    for name in PROGRAMS:
        program = write(place / name, f"#!/bin/sh\necho {name} >> '{left}'\n")
        program.chmod(0o755)
    asked = dice.choice((*COMMANDS, *OTHERS))
    words = [str(scene), *(["--out", out] if asked in ("export", "select") else [])]
    words += ["--rois", good_boxes(folder)] if asked == "select" else []
    write(place / "what", "\n".join([asked, *words]))
    return Case(["beside", str(place)], statuses=(0,))


FAMILIES: dict[str, tuple[Callable[[random.Random, Path], Case], int]] = {
    "working_folders": (working_folders, 40)
}
