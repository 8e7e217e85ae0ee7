"""Runs cases in this process, with bounds on memory and time; one JSON line per case on stdout.

`python -m tests.fuzz.worker FAMILY NUMBER` runs one; without arguments, those named on standard
input, one a line. A case that is out of bounds ends the process: its line is the one missing.
"""

from __future__ import annotations

import contextlib
import faulthandler
import importlib
import importlib.util
import io
import json
import os
import re
import resource
import stat
import sys
import tempfile
import traceback
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.memory import resident
from roigs_addon.geometry.splat_cloud import read_splats
from roigs_engine import cli
from roigs_engine.app.outputs import Result
from roigs_engine.commands.table import COMMANDS, Command
from roigs_engine.errors import EngineError
from roigs_engine.requests.declare import Request, option
from roigs_engine.requests.runs import Train
from roigs_engine.requests.values import PATH
from tests.fuzz import (
    cases,
    exchange,
    run_folders,
    stores,
    videos,
    work_folders,
    working_folders,
)

MEMORY = 2 << 30  # bytes of a case, above what the process has
SECONDS = 60.0
LARGE = 1 << 30  # bytes: no case has so large a file that is no hole
# Characters of names that no terminal may get; only progress bars may return to a line's start.
CONTROLS = re.compile(r"[\x00-\x09\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\u202e]")
HEAVY = ("torch", "scipy.spatial", "sklearn.gaussian_process", "pycolmap", "PIL.Image", "tqdm",
         "sklearn.cluster",
         "roigs_engine.run.folder", "roigs_engine.evaluation.crops",
         "roigs_engine.rasterize.view", "roigs_engine.levels.make",
         "roigs_engine.masking.box_masks")  # fmt: skip
FORMATS = ("gsply.spz", "imagecodecs", "pygltflib", "zstandard")
VIDEO = ("av",) if importlib.util.find_spec("av") else ()


@dataclass(frozen=True, kw_only=True)
class Decode(Request):
    """A scene."""

    scene: Path = option(PATH, "folder", required=True, flags=())


@dataclass(frozen=True, kw_only=True)
class Splats(Request):
    """A file of Gaussians."""

    ply: Path = option(PATH, "file", required=True, flags=())


def claim(request: Any, context: Any) -> Result:
    """The command `train` without its training: everything that looks at the input."""
    from roigs_engine.app.asked import Asked
    from roigs_engine.app.event_log import logged
    from roigs_engine.app.train import opened
    from roigs_engine.run.stages import PhotoSets

    asked = Asked.of(request)
    with logged(context) as (context, log), opened(asked, context, log) as (run, context):
        PhotoSets(run, context).selections()
    return Result()


def decode(request: Any, context: Any) -> Result:
    """Loads a scene with all its pixels, as training does."""
    from roigs_engine.colmap.project import load_colmap
    from roigs_engine.photos.cache import PhotoCache

    scene = load_colmap(request.scene, max_side=64, cache=request.scene / "../out", context=context)
    with PhotoCache(scene.images) as cache:
        for index in range(len(cache)):
            with contextlib.suppress(EngineError):
                camera, pixels = scene.images[index].camera, cache[index]
                assert pixels.shape[:2] == (camera.height, camera.width)
                assert pixels.shape[2] in (3, 4)  # with a mask
    return Result()


def splats(request: Any, context: Any) -> Result:
    """The add-on's reader of PLYs, which refuses with a ValueError."""
    try:
        read_splats(request.ply)
    except ValueError as error:
        raise EngineError(str(error)) from error
    return Result()


def _command(request: type[Request], does: Any) -> Command:
    """A command for tests, which is done by a function of this module."""
    made = Command(request=request, does="", help="for tests", examples=())
    object.__setattr__(made, "run", lambda request, context, _: does(request, context))
    return made


COMMANDS |= {
    "claim": _command(Train, claim),
    "decode": _command(Decode, decode),
    "splats": _command(Splats, splats),
    "beside": _command(working_folders.Beside, working_folders.beside),
    "frames": _command(videos.Frames, videos.take),
    "resume": _command(work_folders.Resumed, work_folders.resume),
    "store": _command(stores.StoreWork, stores.work_on_store),
}


def complaint(family: str, number: int) -> str:
    """Run one case; what is wrong with how it ended, or nothing."""
    with tempfile.TemporaryDirectory(prefix="roigs-fuzz-") as name:
        folder = Path(name) / "a" / "b" / "case"
        (folder / "in").mkdir(parents=True)
        command = cases.make(family, number, folder)
        before = contents(folder, command.keeps)
        out, err = io.StringIO(), io.StringIO()
        status: object
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                status = cli.main(command)
        except BaseException:
            return f"{command}\n{traceback.format_exc(limit=-6)}"
        said = err.getvalue()
        errors = [line for line in said.splitlines() if line.startswith("error: ")]
        if status not in command.statuses or len(errors) != (status == 2):
            return f"{command}: status {status}\n{said}"
        if errors and command.names and not any(name in errors[0] for name in command.names):
            return f"{command}: the line names none of {command.names}\n{said}"
        if status == 2 and not said.rstrip("\n").rpartition("\n")[2].startswith("error: "):
            return f"{command}: an error of several lines\n{said}"
        if CONTROLS.search(out.getvalue() + said):
            return f"{command}: control characters\n{out.getvalue()!r}\n{said!r}"
        if "Warning:" in said or "Traceback" in said:
            return f"{command}: a warning of Python's\n{said}"
        after = contents(folder, before)
        if changed := [path for path in after if after[path] != before.get(path)]:
            return f"{command}: files of the user's were changed: {changed[:9]}"
        return unfinished(Path(name), folder) or str(status)


def contents(folder: Path, names: Iterable[str]) -> dict[str, bytes | None]:
    """Each file of the input, and those of these names, with its bytes; None: it is gone."""
    found = {str(p.relative_to(folder)) for p in (folder / "in").rglob("*") if is_file(p)}
    paths = {name: folder / name for name in sorted({*found, *names})}
    return {name: _content(path) if is_file(path) else None for name, path in paths.items()}


def _content(path: Path) -> bytes:
    """Of a file; of one of holes, its size."""
    size = path.stat().st_size
    return path.read_bytes() if size < LARGE else str(size).encode()


def is_file(path: Path) -> bool:
    """Whether it is a readable file, reached through no link."""
    linked = path.is_symlink() or not os.access(path, os.R_OK)
    return not linked and stat.S_ISREG(os.lstat(path).st_mode)


def unfinished(root: Path, folder: Path) -> str:
    """Files that lie where none belongs, or that are not whole."""
    for path in root.rglob("*"):
        inside = path == folder or folder in path.parents or path in folder.parents
        if not inside or (path.parent == folder and path.name not in ("in", "out")):
            return f"written outside: {path.relative_to(root)}"
        if path.name.endswith(".part"):
            return f"left behind: {path.relative_to(root)}"
    return ""


def limit_memory() -> None:
    """Let the process map `MEMORY` more: libraries that earlier cases have loaded stay mapped."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))


def main(chosen: list[tuple[str, int]]) -> None:
    """Run the cases and report."""
    report = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what libraries print themselves does not mix with it
    for module in (*HEAVY, *(FORMATS if exchange.INSTALLED else ()), *VIDEO):
        importlib.import_module(module)
    from roigs_engine.kernels.library import set_threads

    set_threads(1)
    sys.modules["torch"].set_num_threads(1)
    complaint("model_bytes", 0)  # loads what is loaded late
    if {"checkpoints", "stage_records"} & {family for family, _ in chosen}:
        run_folders.stopped_runs()  # kept: making them would count against a case's time
    on_stores = {"store_commits", "store_outages", "clean", "caches", "amplified"}
    if on_stores & {family for family, _ in chosen}:
        stores.published()
    for family, number in chosen:
        limit_memory()
        faulthandler.dump_traceback_later(SECONDS, exit=True)
        ended = complaint(family, number)
        faulthandler.cancel_dump_traceback_later()
        # Not ru_maxrss: that begins with what the starting process had.
        line = {"case": f"{family} {number}", "ended": ended, "peak_mib": resident("VmHWM")}
        print(json.dumps(line), file=report, flush=True)


if __name__ == "__main__":
    lines = [" ".join(sys.argv[1:])] if len(sys.argv) > 1 else sys.stdin.read().splitlines()
    main([(name, int(number)) for name, number in map(str.split, lines)])
