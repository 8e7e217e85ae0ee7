"""Measures Blender's memory while results are loaded, replaced and unloaded again and again.

    python -m tools.window.memory BLENDER --engine-python PYTHON --run FOLDER [FOLDER]

Each FOLDER is a finished run of the same boxes, of the demo scene if `--scene` names no other; it
is copied. Each cycle shows the next photo behind its camera, gives the run the files of the next
FOLDER, shows one as a preview, as a training does, loads the results, turns the view, moves an
object twice and undoes that once. A new file is begun every `--new-file` cycles. Without, undo
keeps earlier results until Blender has made as many steps as it keeps (Preferences, System: 32):
three each cycle. Prints the resident memory of Blender after each cycle, and how far it strays
after the twelfth, when the history is full; the exit status is 1 when that is more than 5 %. Needs
what `driver` needs.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import sys
import tempfile
from pathlib import Path

from .driver import Blender
from .scenario import SCENE, addon, parser, prepare, window

FILES = ("manifest.json", "background.ply", "result.ply", "split.json", "coarse", "rois")
VIEWPORT, SPLATS = addon("viewport.draw"), addon("scene.splats")
PREVIEW = "__import__('pathlib').Path({!r})"
WARM, STRAY = 12, 0.05
"""Cycles before memory is compared; largest relative difference from then on."""

TURN = """
area = view()["area"]
turn = __import__("mathutils").Quaternion((0, 0, 1), 0.5)
area.spaces.active.region_3d.view_perspective = "PERSP"
area.spaces.active.region_3d.view_rotation = turn @ area.spaces.active.region_3d.view_rotation
area.tag_redraw()
"""
PUSH = "call('ed.undo_push', message={!r})"
"""Code that creates an undo step; operators called by scripts create none."""

EDIT = """
item = next(o for o in bpy.data.objects if o.roigs.kind == "SPLATS" and o.visible_get())
item.location.x += 0.1
call("ed.undo_push", message="Move")
"""


def begin(blender: Blender, scene: Path, run: Path) -> None:
    """Open a new file, and import a scene."""
    blender.ask("bpy.ops.wm.read_homefile(app_template='')")
    blender.pause(1.0)
    prepare(blender)
    blender.ask(f"call('roigs.import_colmap', directory={str(scene)!r})")
    blender.ask(f"bpy.context.scene.roigs.run_dir = {str(run)!r}")
    blender.ask(PUSH.format("Import"))


def replace(run: Path, source: Path) -> None:
    """Replace the run's files of Gaussians, as a training does."""
    for target in run.rglob("*.ply"):
        shutil.copyfile(source / target.relative_to(run), target.with_suffix(".part"))
        target.with_suffix(".part").replace(target)


def settle(blender: Blender) -> None:
    """Wait until the viewport has read and sorted the Gaussians, and has drawn."""
    blender.pause(0.3)
    blender.until(f"{VIEWPORT}._painter is None or {VIEWPORT}._painter.idle()", 120)
    blender.pause(0.4)
    blender.ask("0")


def cycle(blender: Blender, run: Path, source: Path) -> None:
    """The actions of a user in a few minutes."""
    blender.ask("call('roigs.look_through', step=1)")
    blender.ask(PUSH.format("Look Through"))
    settle(blender)
    replace(run, source)
    path = PREVIEW.format(str(run / "result.ply"))
    blender.ask(f"{SPLATS}.show_preview(bpy.context.scene, {path}) and None")
    settle(blender)
    blender.ask("call('roigs.load_results')", 120)
    blender.ask(PUSH.format("Load Results"))
    settle(blender)
    for _ in range(2):
        blender.ask(TURN)
        settle(blender)
    for _ in range(2):
        blender.ask(EDIT)
        settle(blender)
    blender.ask("call('ed.undo')")
    settle(blender)


def resident(pid: int) -> float:
    """Resident memory of a process, MB."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def watch(blender: Blender, run: Path, given: argparse.Namespace) -> list[float]:
    """Resident memory after each cycle, MB."""
    sizes = []
    for number in range(given.cycles):
        if number % (given.new_file or given.cycles) == 0:
            begin(blender, given.scene, run)
        cycle(blender, run, given.run[number % len(given.run)])
        sizes.append(resident(blender.process.pid))
        meshes, images = blender.ask("[len(bpy.data.meshes), len(bpy.data.images)]")
        print(f"{number + 1} {sizes[-1]:.0f} MB, meshes {meshes}, images {images}", flush=True)
    return sizes


def main() -> int:
    """Run the cycles, and compare memory."""
    options = parser(__doc__)
    options.add_argument("--run", type=Path, required=True, nargs="+", help="finished runs")
    options.add_argument("--scene", type=Path, default=SCENE, help="its COLMAP project")
    options.add_argument("--cycles", type=int, default=50)
    options.add_argument("--new-file", type=int, default=0, help="cycles until a new file")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        run = Path(temporary) / "run"
        run.mkdir()
        for name in FILES:
            copy = shutil.copytree if (given.run[0] / name).is_dir() else shutil.copyfile
            copy(given.run[0] / name, run / name)
        with window(given, 1600, 1000) as blender:
            sizes = watch(blender, run, given)
    rest = sizes[WARM - 1 :] or sizes[-1:]
    middle = statistics.median(rest)
    stray = max(abs(size - middle) for size in rest) / middle
    print(f"from cycle {WARM}: {min(rest):.0f} to {max(rest):.0f} MB, {100 * stray:.1f} % astray")
    return int(stray > STRAY)


if __name__ == "__main__":
    sys.exit(main())
