"""Measures levels of detail in a real Blender window, and whether a fly-in shows them switch.

    python -m tools.window.levels BLENDER --engine-python PYTHON --run FOLDER [--frames 120]

FOLDER is a finished run of the demo scene with levels of detail, of which it takes a copy.
Distances are counted in pixels per unit, as the levels are: at twice the distance, a view is twice
as coarse as the photos.

Prints Gaussians and redraw time where the whole scene is 4 times as far as its photos, and the PSNR
against the whole model at photos' places, in pictures of a quarter of their sides. Then it flies
towards the vase, through the room, and prints the largest change from one frame to the next beyond
that of the whole model: of the mean of all pixels, and of the worst tile. The exit status is 1 when
a goal is missed. With `--picture FILE`, it makes the picture of docs/user_guide.md instead. Needs
what `driver` needs.
"""

from __future__ import annotations

import shutil
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from .driver import Blender
from .pictures import COLOURS, LOOK, show_result
from .redraw import DRAWN
from .scenario import (
    addon,
    import_demo,
    load_boxes,
    open_result_panel,
    parser,
    prepare,
    window,
)

FAR = 4.0
FARTHEST, NEAREST = 5.0, 1.0
"""Distances of the fly-in, as multiples of the photos'."""
SIZE, SHOWN, CROP = (1200, 800), 1.5, "675x778+525+0"
"""Size of the window; distance and crop of the picture."""
PHOTOS = [f"wide/wide_{number:03}.jpg" for number in (3, 17, 31, 45)]
TIMES = 7
MOST_CHANGE = 0.01
LEAST_FASTER = 3.0

TOOLS = f"""
import numpy as np
import gpu
from mathutils import Matrix, Vector
draw, objects = {addon("viewport.draw")}, {addon("viewport.objects")}
targets, View = {addon("viewport.targets")}, {addon("viewport.view")}.View
ladders, levels = {addon("scene.ladders")}, {addon("shared")}.levels
details = {{
    item: ladders.of(item, bpy.context.scene)
    for item in bpy.data.objects if ladders.of(item, bpy.context.scene)
}}
vase = next(item for item in details if item.roigs.roi == "vase")
middle = vase.matrix_world @ Vector(details[vase].ladder.probes.mean(axis=0))
held = {{}}

def coarser(place, items):
    "How many times coarser than their photos a view shows objects; the finest of them."
    found = []
    for item in items:
        ladder, matrix = details[item].ladder, np.array(item.matrix_world, float)
        clip = np.array(place.projection @ place.matrix, float)
        focal = max(abs(place.projection[k][k]) * place.size[k] / 2 for k in (0, 1))
        scale = np.linalg.norm(matrix[:3, :3], 2)
        rate = levels.rate_in_view(ladder.probes, clip @ matrix, focal * scale)
        found.append(ladder.rate / max(rate, 1e-9))
    return min(found)

def picture(place):
    "(H, W, 3) of a view's Gaussians, and how many are drawn."
    made = gpu.types.GPUOffScreen(*place.size, format="RGBA16F")
    with made.bind():
        gpu.state.active_framebuffer_get().clear(color=(0.0, 0.0, 0.0, 0.0))
        found = objects.marked(details, None, bpy.context.scene)
        draw.painter().draw(found, place, key="tool", wait=True)
        pixels = made.texture_color.read()
    pixels.dimensions = place.size[0] * place.size[1] * 4
    made.free()
    shown = np.array(pixels, np.float32).reshape(place.size[1], place.size[0], 4)
    return shown[..., :3].clip(0, 1), draw.painter().counts["tool"][0]

def use(levels):
    bpy.context.scene.roigs.use_levels = levels

# From afar.

def go(times):
    "Move the 3D view back until all of the scene is that many times coarser than its photos."
    area, data = view()["region"], view()["area"].spaces.active.region_3d
    data.view_location = middle
    low, high = 1e-3, 1e3
    for _ in range(40):
        data.view_distance = (low * high) ** 0.5
        data.update()
        place = View(data.view_matrix, data.window_matrix, (area.width, area.height))
        if coarser(place, details) < times:
            low = data.view_distance
        else:
            high = data.view_distance

# At photos' places.

def psnr(photo, shrink):
    "Of a smaller photo with levels against without, and its Gaussians."
    call("roigs.look_through", photo=photo)
    camera, graph = bpy.context.scene.camera, bpy.context.evaluated_depsgraph_get()
    render = bpy.context.scene.render
    size = round(render.resolution_x / shrink), round(render.resolution_y / shrink)
    projection = camera.calc_matrix_camera(graph, x=size[0], y=size[1])
    place = View(camera.matrix_world.normalized().inverted(), projection, size)
    use(False)
    whole, every = picture(place)
    use(True)
    shown, count = picture(place)
    return float(-10 * np.log10(np.square(whole - shown).mean() + 1e-12)), count, every

# Through the room.

def frame(distance):
    "The vase, from within the room; in small pictures, far is near enough for the room."
    away = Vector((0.8, 0.6, 0.2)).normalized()
    turn = away.to_track_quat("Z", "Y").to_matrix().to_4x4()
    pose = Matrix.Translation(middle + distance * away) @ turn
    x, y = 2 * 180 / 300, 2 * 180 / 200
    projection = Matrix(((x, 0, 0, 0), (0, y, 0, 0), (0, 0, -1, -0.02), (0, 0, -1, 0)))
    return View(pose.inverted(), projection, (300, 200))

def away(times):
    "How far from the vase it is that many times coarser than its photos."
    low, high = 1e-3, 1e3
    for _ in range(40):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if coarser(frame(middle), [vase]) < times else (low, middle)
    return middle

def change(distance, name):
    "Mean change of all pixels since the frame of that name, of the worst tile; Gaussians."
    now, count = picture(frame(distance))
    before = held.get(name, now)
    held[name] = now
    error = np.abs(now - before).mean(axis=2)
    rows, columns = (side // 32 for side in error.shape)
    error_in_tiles = error[: rows * 32, : columns * 32].reshape(rows, 32, columns, 32)
    return float(error.mean()), float(error_in_tiles.mean(axis=(1, 3)).max()), count
"""


def prepared(blender: Blender, run: Path) -> None:
    """Load the result, and hide everything else."""
    prepare(blender)
    import_demo(blender)
    load_boxes(blender)
    blender.ask(f"bpy.context.scene.roigs.run_dir = {str(run)!r}")
    blender.ask("call('roigs.load_results')", 300)
    blender.ask(TOOLS)
    blender.ask(DRAWN)
    blender.ask(
        "view()['area'].spaces.active.clip_end = 1000\n"
        "for item in bpy.data.objects:\n"
        "    item.hide_set(item.roigs.kind != 'SPLATS')\n"
        "    item.select_set(False)\n"
    )
    blender.pause(3.0)


def from_afar(blender: Blender) -> bool:
    """Print Gaussians and time with and without levels; whether levels are fast enough."""
    blender.ask(f"go({FAR})", 120)
    seconds = {}
    for levels in (True, False):
        blender.ask(f"use({levels})")
        blender.ask("drawn()", 300)
        blender.until("draw.painter().idle()", 120)
        blender.pause(3.0)
        full = "(draw.painter()._pictures.clear(), drawn())[1]"
        times = [blender.ask(full, 300) for _ in range(TIMES)]
        clock, processor = (statistics.median(column) for column in zip(*times, strict=True))
        seconds[levels] = processor
        count = blender.ask("draw.counts(view()['area'])[0]")
        name = "with levels" if levels else "whole"
        print(f"{name:<12} {count:,} Gaussians, {clock:.2f} s, {processor:.2f} s of processor time")
    blender.ask("[item.hide_set(True) for item in details] and None")
    blender.pause(2.0)
    clock, processor = np.median([blender.ask("drawn()", 300) for _ in range(TIMES)], axis=0)
    print(f"the window without any: {clock:.2f} s, {processor:.2f} s of processor time")
    blender.ask("[item.hide_set(False) for item in details] and None")
    faster = seconds[False] / seconds[True]
    print(f"{FAR:g} times as far, {faster:.1f} times as fast", flush=True)
    return bool(faster >= LEAST_FASTER)


def at_photos(blender: Blender) -> None:
    """Print the PSNR against the whole model in small pictures."""
    found = [blender.ask(f"psnr({photo!r}, {FAR})", 300) for photo in PHOTOS]
    mean, count, every = np.mean(found, axis=0)
    print(
        f"{len(PHOTOS)} photos of 1/{FAR:g} of their sides: {count:,.0f} of {every:,.0f}"
        f" Gaussians, {mean:.1f} dB against the whole model",
        flush=True,
    )


def photograph(blender: Blender, path: Path) -> None:
    """Take a picture of the open panel beside the scene, at a distance that uses levels."""
    blender.ask(LOOK)
    blender.ask("[item.hide_set(True) for item in details] and None")  # finding buttons is faster
    open_result_panel(blender, "roigs.make_levels", x=0.5)
    blender.ask("[item.hide_set(False) for item in details] and None")
    blender.ask(f"use(True)\ngo({SHOWN})", 120)
    blender.screen.do("mousemove", "3", "450")
    blender.until("draw.painter().idle()", 120)
    show_result(blender)
    blender.screen.do("mousemove", "3", "450")  # away from the sidebar, to avoid a tooltip
    blender.pause(3.0)
    blender.screen.picture(path, CROP, *COLOURS)


def fly(blender: Blender, distances: list[float], *, levels: bool) -> np.ndarray[Any, Any]:
    """(frames, 3) results of `change` for each frame."""
    blender.ask(f"use({levels})")
    return np.array([blender.ask(f"change({d}, '{levels}')", 300) for d in distances])


def fly_in(blender: Blender, frames: int) -> bool:
    """Fly in with and without levels; whether no switch between levels is visible."""
    first, last = (float(blender.ask(f"away({times})", 120)) for times in (FARTHEST, NEAREST))
    distances = np.geomspace(first, last, frames).tolist()
    with_levels = fly(blender, distances, levels=True)
    whole = fly(blender, distances, levels=False)
    beyond = (with_levels - whole)[1:, :2].max(axis=0)
    worst = int((with_levels - whole)[:, 0].argmax())
    ends = f"{with_levels[0, 2]:,.0f} to {with_levels[-1, 2]:,.0f} of {whole[0, 2]:,.0f} Gaussians"
    print(f"{frames} frames from {first:.2f} to {last:.2f}: {ends}")
    usual, tile = whole[1:, :2].max(axis=0)
    print(f"largest change of the whole model {usual:.2%}, of a tile {tile:.2%}")
    print(f"beyond that with levels {beyond[0]:.2%} (frame {worst}), of a tile {beyond[1]:.2%}")
    return bool(beyond[0] <= MOST_CHANGE)


def main() -> int:
    """Measure."""
    options = parser(__doc__)
    options.add_argument("--run", type=Path, required=True, help="a finished run with levels")
    options.add_argument("--frames", type=int, default=120)
    options.add_argument("--picture", type=Path, help="of the panel, as a PNG, instead of all that")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as temporary, window(given, *SIZE) as blender:
        run = copied(given.run, Path(temporary) / "run")
        prepared(blender, run)
        if given.picture:
            photograph(blender, given.picture)
            return 0
        good = [from_afar(blender), fly_in(blender, given.frames)]
        at_photos(blender)
        problems = blender.ask("draw.problems()")
        print(problems or "nothing is wrong")
    return int(not all(good) or bool(problems))


def copied(run: Path, folder: Path) -> Path:
    """Copy the files of a run that the add-on reads, with their times; Blender changes the copy."""
    folder.mkdir()
    for name in ("rois", "coarse", "levels"):
        shutil.copytree(run / name, folder / name)
    for name in ("result.ply", "background.ply", "levels.json", "manifest.json"):
        shutil.copy2(run / name, folder / name)
    return folder


if __name__ == "__main__":
    sys.exit(main())
