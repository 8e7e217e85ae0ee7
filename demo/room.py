# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo room: x to the east, y to the north, z up, metres."""

from __future__ import annotations

import bpy
import numpy as np
import prints
import textures as tx
from bookshelf import bookshelf
from build import IDENTITY, box, image, image_material, lathe, panel, place, sheet
from furniture import armchair, chairs, plant, sideboard, table
from materials import Library
from mathutils import Matrix
from measures import HALF_X, HALF_Y, HEIGHT


def build_room(lib: Library) -> None:
    """The whole room without the objects that get a box."""
    shell(lib)
    window(lib)
    pictures(lib)
    door(lib)
    bookshelf(lib)
    table(lib)
    chairs(lib)
    sideboard(lib)
    armchair(lib)
    plant(lib)
    lamps(lib)


def shell(lib: Library) -> None:
    """Floor, ceiling with beams, papered walls with dado, skirting and rail, the rug."""
    boards = image("floor", tx.floor(2080, 1760, 31, 21))
    mat = image_material("floor", boards, (2 * HALF_X, 2 * HALF_Y), 0.0015)
    panel("floor", (2 * HALF_X, 2 * HALF_Y), mat, place(turn=(-90, 0, 0)))
    top = image("ceiling", tx.plaster(1536, 1536, 22, (0.92, 0.90, 0.86), (0.76, 0.73, 0.68)))
    mat = image_material("ceiling", top, (2 * HALF_X, 2 * HALF_X), 0.004)
    panel("ceiling", (2 * HALF_X, 2 * HALF_Y), mat, place((0, 0, HEIGHT), (90, 0, 0)))
    for k, x in enumerate((-1.75, -0.1, 1.6)):
        box(f"beam {k}", (0.16, 2 * HALF_Y, 0.14), (x, 0, HEIGHT - 0.07), lib.dark, bevel=0.008)
    walls = {
        "north": (2 * HALF_X, (0, HALF_Y), 0),
        "east": (2 * HALF_Y, (HALF_X, 0), -90),
        "south": (2 * HALF_X, (0, -HALF_Y), 180),
        "west": (2 * HALF_Y, (-HALF_X, 0), 90),
    }
    for k, (name, (width, (x, y), turn)) in enumerate(walls.items()):
        paper = image(f"paper {name}", tx.wallpaper(2048 if width > 5 else 1734, 1024, 30 + k))
        mat = image_material(f"paper {name}", paper, (width, HEIGHT))
        frame = place((x, y, HEIGHT / 2), (0, 0, turn))
        panel(f"wall {name}", (width, HEIGHT), mat, frame)
        floor_frame = place((x, y, 0), (0, 0, turn))
        trim = ((0.13, 0.02, 0.065), (0.05, 0.03, 0.92), (0.09, 0.04, HEIGHT - 0.045))
        for n, (tall, deep, z) in enumerate(trim):
            mat = lib.paint if n != 1 else lib.light
            size, centre = (width, deep, tall), (0, -deep / 2, z)
            box(f"trim {name} {n}", size, centre, mat, floor_frame, 0.006)
    mat = image_material("rug", image("rug", tx.rug(1920, 1344, 23)), (3.0, 2.1), 0.002)
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:22, 0:31]
    wave = 0.008 + 0.004 * rng.random(y.shape)
    points = np.stack([x / 10 - 1.5, y / 10 - 1.05, wave], -1)
    sheet("rug", points, (3.0, 2.1), mat, place((0.05, 0.0, 0.0), (0, 0, 3)))


def window(lib: Library) -> None:
    """A window on the north wall: a bright painted view, frame, sill and curtains."""
    x, z, width, height = -0.55, 1.55, 1.5, 1.2
    view = image("view", prints.landscape(1280, 1024, 41))
    mat = image_material("view", view, (width, height), emission=0.75)
    panel("window view", (width, height), mat, place((x, HALF_Y - 0.012, z)))
    front = HALF_Y - 0.03
    for k, dx in enumerate((-0.75, -0.25, 0.25, 0.75)):
        wide = 0.09 if k in (0, 3) else 0.035
        box(
            f"window post {k}",
            (wide, 0.06, height + 0.1),
            (x + dx, front, z),
            lib.paint,
            bevel=0.006,
        )
    for k, dz in enumerate((-0.6, 0.12, 0.6)):
        tall = 0.035 if k == 1 else 0.09
        box(
            f"window bar {k}",
            (width + 0.1, 0.055, tall),
            (x, front, z + dz),
            lib.paint,
            bevel=0.006,
        )
    box("sill", (width + 0.25, 0.2, 0.04), (x, HALF_Y - 0.1, z - 0.66), lib.light, bevel=0.008)
    cloth = tx.fabric(1024, 1536, 42, (0.60, 0.34, 0.26), tx.WARM[1:5] + tx.LEAVES[:2], 260)
    mat = image_material("curtain", image("curtain", cloth), (0.9, 1.75))
    mirrored = image_material(
        "curtain 2", image("curtain 2", cloth[:, ::-1].copy()), (0.9, 1.75), 0.95
    )
    v, u = np.mgrid[0:30, 0:120]
    u, v = u / 119.0, v / 29.0
    fold = 0.03 * np.sin(u * 44.0 + 1.5 * np.sin(4 * v)) * (1.1 - 0.4 * v)
    for side, material in ((-1, mat), (1, mirrored)):
        spread = (u - 0.5) * 0.52 * (1.0 - 0.16 * np.sin(np.pi * v))
        points = np.stack([spread, fold, v * 1.75], -1)
        sheet(
            f"curtain {side}", points, (0.9, 1.75), material, place((x + side * 0.98, 2.09, 0.55))
        )
    turn = place((x - 1.3, 2.08, 2.32), (0, 90, 0))
    lathe("curtain rod", ((0.014, 0.0), (0.014, 2.6)), lib.dark, turn, 16)
    items = ("jug", "pot", "bottle")
    for k, name in enumerate(items):
        shape = ((0.001, 0), (0.05, 0), (0.062, 0.06), (0.03 + 0.01 * k, 0.14), (0.042, 0.17))
        pixels = tx.fabric(512, 512, 45 + k, tx.WARM[3 - k], tx.LEAVES + tx.WARM[:2], 60)
        mat = image_material(f"sill {name}", image(f"sill {name}", pixels), (0.35, 0.35))
        lathe(f"sill {name}", shape, mat, place((x - 0.4 + 0.37 * k, HALF_Y - 0.1, z - 0.64)))


def framed(
    name: str, pixels: np.ndarray, size: tuple[float, float], frame: Matrix, lib: Library
) -> None:
    """A picture with mount and frame; the frame's origin lies on the wall, facing -Y."""
    w, h = size
    mat = image_material(name, image(name, pixels), size)
    panel(f"{name} canvas", size, mat, frame @ place((0, -0.018, 0)))
    box(f"{name} mount", (w + 0.08, 0.012, h + 0.08), (0, -0.008, 0), lib.paint, frame)
    wood = lib.dark if len(name) % 2 else lib.light
    for k, sign in enumerate((-1, 1)):
        box(
            f"{name} a{k}",
            (w + 0.14, 0.035, 0.04),
            (0, -0.018, sign * (h / 2 + 0.05)),
            wood,
            frame,
            0.006,
        )
        box(
            f"{name} b{k}",
            (0.04, 0.035, h + 0.1),
            (sign * (w / 2 + 0.05), -0.018, 0),
            wood,
            frame,
            0.006,
        )


def pictures(lib: Library) -> None:
    """Pictures on all four walls, no two alike."""

    def on_wall(x: float, y: float, z: float, turn: float) -> Matrix:
        return place((x, y, z), (0, 0, turn))

    south, west, east = -HALF_Y, -HALF_X, HALF_X
    framed(
        "map", prints.contour_map(1280, 880, 51), (1.05, 0.72), on_wall(0.35, south, 1.72, 180), lib
    )
    framed(
        "patches", prints.patchwork(640, 800, 52), (0.4, 0.5), on_wall(1.55, south, 1.6, 180), lib
    )
    framed(
        "bouquet", prints.bouquet(720, 960, 53), (0.54, 0.72), on_wall(west, 0.25, 1.65, 90), lib
    )
    framed(
        "hills", prints.landscape(960, 640, 54), (0.66, 0.44), on_wall(west, -0.75, 1.75, 90), lib
    )
    framed("cubes", prints.patchwork(640, 640, 55), (0.4, 0.4), on_wall(west, -1.55, 1.5, 90), lib)
    framed(
        "isle", prints.contour_map(640, 800, 56), (0.4, 0.5), on_wall(1.15, HALF_Y, 1.85, 0), lib
    )
    framed("posy", prints.bouquet(640, 640, 57), (0.36, 0.36), on_wall(1.75, HALF_Y, 1.55, 0), lib)
    framed("dunes", prints.landscape(640, 480, 58), (0.4, 0.3), on_wall(1.25, HALF_Y, 1.25, 0), lib)
    framed(
        "valley", prints.landscape(640, 860, 59), (0.42, 0.56), on_wall(east, -1.6, 1.6, -90), lib
    )
    framed("study", prints.bouquet(640, 800, 60), (0.4, 0.5), on_wall(east, 1.65, 1.65, -90), lib)


def door(lib: Library) -> None:
    """A panelled door in the south wall."""
    frame = place((-1.65, -HALF_Y, 0), (0, 0, 180))
    box("door leaf", (0.84, 0.03, 2.02), (0, -0.015, 1.01), lib.light, frame)
    for k, (x, z, w, h) in enumerate(
        (
            (-0.2, 0.5, 0.3, 0.66),
            (0.2, 0.5, 0.3, 0.66),
            (-0.2, 1.42, 0.3, 0.9),
            (0.2, 1.42, 0.3, 0.9),
        )
    ):
        box(f"door panel {k}", (w, 0.02, h), (x, -0.035, z), lib.light, frame, 0.012)
        box(f"door field {k}", (w - 0.1, 0.02, h - 0.1), (x, -0.045, z), lib.dark, frame, 0.012)
    for k, x in enumerate((-0.48, 0.48)):
        box(f"door post {k}", (0.1, 0.05, 2.12), (x, -0.025, 1.06), lib.paint, frame, 0.01)
    box("door head", (1.08, 0.062, 0.1), (0, -0.031, 2.12), lib.paint, frame, 0.01)
    knob = ((0.001, 0), (0.02, 0), (0.012, 0.03), (0.028, 0.045), (0.024, 0.07), (0.001, 0.075))
    lathe("door knob", knob, lib.brass, frame @ place((0.36, -0.03, 1.0), (90, 0, 0)), 24)


def lamps(lib: Library) -> None:
    """A floor lamp and a pendant, and the light that represents them and the window."""
    pixels = tx.fabric(1024, 384, 131, (0.88, 0.80, 0.62), tx.WARM[:2] + tx.LEAVES[:3], 160)
    mat = image_material("shade", image("shade", pixels), (1.3, 0.4), emission=0.12)
    frame = place((-2.2, -0.25, 0))
    lathe(
        "lamp foot",
        ((0.001, 0), (0.15, 0), (0.14, 0.025), (0.02, 0.04), (0.014, 1.3)),
        lib.brass,
        frame,
    )
    lathe("lamp shade", ((0.24, 1.22), (0.14, 1.58)), mat, frame)
    lathe(
        "pendant shade",
        ((0.2, 2.12), (0.19, 2.16), (0.08, 2.3), (0.01, 2.34), (0.006, 2.6)),
        mat,
        IDENTITY,
    )
    area("ceiling light", (0.0, 0.0, 2.42), (0, 0, 0), (4.2, 3.4), 92.0, (1.0, 0.95, 0.88))
    for k, sign in enumerate((-1, 1)):
        spot, turn = (sign * 1.2, 0.0, 2.2), (0, -sign * 62, 0)
        area(f"fill light {k}", spot, turn, (0.5, 3.0), 22.0, (1.0, 0.96, 0.9))
    area("window light", (-0.55, 1.95, 1.6), (-80, 0, 0), (1.5, 1.2), 36.0, (0.92, 0.96, 1.0))


def area(
    name: str,
    location: tuple[float, float, float],
    turn: tuple[float, float, float],
    size: tuple[float, float],
    power: float,
    colour: tuple[float, float, float],
) -> None:
    """A rectangular light that no camera sees; it shines along its local -Z."""
    data = bpy.data.lights.new(name, "AREA")
    data.shape = "RECTANGLE"
    data.size, data.size_y = size
    data.energy, data.color = power, colour
    lamp = bpy.data.objects.new(name, data)
    lamp.matrix_world = place(location, turn)
    lamp.visible_camera = False
    bpy.context.scene.collection.objects.link(lamp)
