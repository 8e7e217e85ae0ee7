"""Measures how long a real Blender window takes to draw a scene: still, turning, at rest again.

    python -m tools.window.redraw BLENDER --engine-python PYTHON --run FOLDER

FOLDER is a finished run. Prints the medians of wall clock and of Blender's processor time, which
says more on a busy machine. The exit status is 1 when a view that rests is not drawn in full. Needs
what `driver` needs.
"""

from __future__ import annotations

import os
import statistics
import sys
from pathlib import Path

from .driver import Blender
from .scenario import addon, parser, window

DRAW, SPLATS = addon("viewport.draw"), addon("scene.splats")
PREPARE = """
bpy.context.preferences.view.show_splash = False
bpy.context.preferences.view.smooth_view = 0
for item in list(bpy.data.objects):
    bpy.data.objects.remove(item)
"""
LOOK = """
matrix = __import__("mathutils").Matrix
space = view()["area"].spaces.active
item = next(o for o in bpy.data.objects if o.roigs.level == "ROI")
place = item.matrix_world @ item.data.vertices[0].co
space.region_3d.view_location = place
space.region_3d.view_distance = 4
"""
DRAWN = """
def turn(angle):
    data = view()["area"].spaces.active.region_3d
    step = __import__("mathutils").Quaternion((0, 0, 1), angle)
    data.view_rotation = step @ data.view_rotation
def drawn():
    clock, processor = time.perf_counter(), time.process_time()
    call("wm.redraw_timer", type="DRAW_WIN_SWAP", iterations=1)
    return time.perf_counter() - clock, time.process_time() - processor
def turned(angle):
    turn(angle)
    return drawn()
"""
WIDTHS = f"[picture.pixel for picture in {DRAW}.painter()._pictures.values()]"
TIMES = 7


def show(blender: Blender, text: str, code: str) -> None:
    """Print the median times of several redraws."""
    times = [blender.ask(code) for _ in range(TIMES)]
    clock, processor = (statistics.median(column) for column in zip(*times, strict=True))
    print(f"{text:<22} {clock:.2f} s, {processor:.2f} s of processor time", flush=True)


def measure(blender: Blender, run: Path) -> bool:
    """Print all measurements; whether the viewport reports no problems."""
    blender.ask(PREPARE)
    folder = f"__import__('pathlib').Path({str(run)!r})"
    blender.ask(f"{SPLATS}.show_results(bpy.context.scene, {folder}) and None", 120)
    blender.ask(LOOK)
    blender.ask(DRAWN)
    blender.until(f"{DRAW}._painter is not None and {WIDTHS} == [1]", 60)
    blender.until(f"{DRAW}.painter().idle()", 60)
    blender.pause(2.0)
    region = blender.ask("(view()['region'].width, view()['region'].height)")
    count = blender.ask(f"[order.count for order in {DRAW}.painter()._orders.values()]")
    print(f"{count} Gaussians, {region[0]} x {region[1]} pixels; load {os.getloadavg()[0]:.0f}")
    show(blender, "unchanged", "drawn()")
    show(blender, "turning", "turned(0.03)")
    coarse = blender.ask(WIDTHS)
    took = blender.until(f"{WIDTHS} == [1]", 30)
    print(f"pixels of {coarse} while turning, in full {took:.1f} s later")
    show(blender, "in full", f"({DRAW}.painter()._pictures.clear(), drawn())[1]")
    blender.ask("[item.hide_set(True) for item in bpy.data.objects] and None")
    show(blender, "unchanged without", "drawn()")
    show(blender, "turning without", "turned(0.03)")
    return not blender.ask(f"{DRAW}.problems()")


def main() -> int:
    """Measure."""
    options = parser(__doc__)
    options.add_argument("--run", type=Path, required=True, help="a finished run")
    given = options.parse_args()
    with window(given, 1600, 1000) as blender:
        return int(not measure(blender, given.run))


if __name__ == "__main__":
    sys.exit(main())
