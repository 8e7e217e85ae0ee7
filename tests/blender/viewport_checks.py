"""Checks of the viewport's splats besides their look; run as viewport_parity.py.

    blender -b --factory-startup --python viewport_checks.py -- FOLDER

FOLDER holds two Gaussian PLYs, `a.ply` and `b.ply`, within a distance of 1.2 about the origin.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import bpy
import gpu
import numpy as np
from mathutils import Matrix, Vector

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from roigs_addon.geometry.splat_cloud import SplatCloud, read_splats
from roigs_addon.scene import clouds
from roigs_addon.viewport import draw, pace, points, targets
from roigs_addon.viewport.objects import marked, splat_objects
from roigs_addon.viewport.painter import Painter
from roigs_addon.viewport.view import View
from roigs_engine.formats.splat_ply import read_ply, write_ply
from tests.addon.splat_cases import fine_ply, recoloured
from tests.blender.checks import DISTANCE, FOLDER, SIDE, TURN, glance, run_checks, splats
from tests.blender.gpu_pictures import perspective, picture, psnr


def seen(*objects: bpy.types.Object, distance: float = DISTANCE) -> np.ndarray:
    """Objects around the origin, which fill the picture, from a distance."""
    focal = 0.4 * SIDE * distance
    camera = {"width": SIDE, "height": SIDE, "fx": focal, "fy": focal, "cx": SIDE / 2 + 3}
    clip = perspective({**camera, "cy": SIDE / 2}, distance / 100, distance * 10)
    view = Matrix.Translation((0, 0, -distance)) @ TURN
    return picture(list(objects), view, clip, SIDE, SIDE)


def check_orthographic(a: bpy.types.Object, b: bpy.types.Object) -> None:
    """Parallel light is what a far telephoto lens sees, also with anti-aliasing."""
    fine = splats("fine", fine_ply(FOLDER / "fine.ply", 500, seed=3))
    for items in ((a, b), (a, fine)):
        far = seen(*items, distance=3000.0)
        clip = Matrix.Diagonal((0.8, 0.8, -0.1, 1.0))
        clip[0][3] = 6 / SIDE
        view = Matrix.Translation((0, 0, -DISTANCE)) @ TURN
        flat = picture([*items], view, clip, SIDE, SIDE)
        assert psnr(flat, far) > 40, psnr(flat, far)
        assert psnr(seen(*items), far) < 35, "the same as from near: nothing was compared"
    bpy.data.objects.remove(fine)


def check_one_order_for_all(a: bpy.types.Object, b: bpy.types.Object) -> None:
    """Objects inside one another are sorted together, whichever comes first."""
    both = seen(a, b)
    assert psnr(both, seen(b, a)) > 60
    over = seen(b) + (1 - seen(b)[..., 3:]) * seen(a)
    assert psnr(both, over) < 40, "one over the other: they were not mixed"


def check_hidden(a: bpy.types.Object, b: bpy.types.Object) -> None:
    """Marks and visibility are respected; a path to a missing file is ignored."""
    alone = seen(a)
    assert psnr(alone, seen(a, b)) < 40
    b.roigs.shown_as = "POINTS"
    assert (seen(a, b) == alone).all()
    b.roigs.shown_as = "GAUSSIANS"
    b.hide_viewport = True
    assert (seen(a, b) == alone).all()
    b.hide_viewport = False
    path, b.roigs.ply = b.roigs.ply, str(FOLDER / "nothing.ply")
    assert (seen(a, b) == alone).all()
    (FOLDER / "broken.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\nend_header\n")
    b.roigs.ply = str(FOLDER / "broken.ply")
    assert (seen(a, b) == alone).all()
    assert "broken.ply" in draw.problems()[b.roigs.ply]
    b.roigs.ply = path
    assert not (seen(a, b) == alone).all() and not draw.problems()


def check_faint(a: bpy.types.Object, b: bpy.types.Object) -> None:
    """All of the picture is fainter, so that points in edit mode show through."""
    view, clip = (
        Matrix.Translation((0, 0, -DISTANCE)) @ TURN,
        Matrix.Diagonal((0.8, 0.8, -0.1, 1.0)),
    )
    full, faint = (picture([a, b], view, clip, SIDE, SIDE, strength=s) for s in (1.0, 0.25))
    assert full[..., 3].max() > 0.9 and np.allclose(faint, full / 4, atol=1e-4)


def check_look(a: bpy.types.Object, _b: bpy.types.Object) -> None:
    """Exposure and tint are those of a file with such colours; a copy has its own."""
    gains = 2**0.5 * np.array([1.0, 0.5, 0.25])
    stored = read_ply(a.roigs.ply)
    stored["sh"] = recoloured(stored["sh"], gains)
    write_ply(FOLDER / "tinted.ply", stored)
    c, plain = splats("c", FOLDER / "tinted.ply"), seen(a)
    wanted = seen(c)
    assert psnr(plain, wanted) < 35
    a.roigs.exposure, a.roigs.tint = 0.5, (1.0, 0.5, 0.25)
    assert psnr(seen(a), wanted) > 50, psnr(seen(a), wanted)
    copy = a.copy()
    bpy.context.scene.collection.objects.link(copy)
    assert (seen(copy) == seen(a)).all()
    a.roigs.exposure, a.roigs.tint = 0.0, (1.0, 1.0, 1.0)
    assert (seen(a) == plain).all() and psnr(seen(copy), wanted) > 50
    bpy.data.objects.remove(copy)
    bpy.data.objects.remove(c)


def check_size(a: bpy.types.Object, _b: bpy.types.Object) -> None:
    """A scene of any size looks the same."""
    usual = seen(a)
    for size in (1000.0, 0.001):
        a.matrix_world = Matrix.Diagonal((size, size, size, 1.0))
        focal = 0.4 * SIDE * DISTANCE
        camera = {"width": SIDE, "height": SIDE, "fx": focal, "fy": focal, "cx": SIDE / 2 + 3}
        far = DISTANCE * size
        clip = perspective({**camera, "cy": SIDE / 2}, far / 100, far * 10)
        view = Matrix.Translation((0, 0, -far)) @ TURN
        got = picture([a], view, clip, SIDE, SIDE)
        assert psnr(got, usual) > 50, (size, psnr(got, usual))
    a.matrix_world = Matrix()


def check_changed_file(a: bpy.types.Object, b: bpy.types.Object) -> None:
    """A file that is replaced is read again."""
    path = FOLDER / "changing.ply"
    shutil.copyfile(a.roigs.ply, path)
    c = splats("c", path)
    assert (seen(c) == seen(a)).all()
    shutil.copyfile(b.roigs.ply, path.with_suffix(".part"))
    os.replace(path.with_suffix(".part"), path)
    assert (seen(c) == seen(b)).all()
    bpy.data.objects.remove(c)


def check_stretched(a: bpy.types.Object, _b: bpy.types.Object) -> None:
    """A stretched object covers what its stretched covariances cover, also with anti-aliasing."""
    compare_covered(a, read_splats(a.roigs.ply))
    fine = splats("fine", fine_ply(FOLDER / "fine.ply", 500, seed=3))
    cloud = read_splats(fine.roigs.ply)
    assert cloud.antialiased
    compare_covered(fine, cloud)
    plain = np.square(covered(cloud, antialiased=False) - covered(cloud)).mean()
    assert plain > 1e-3, "no difference: anti-aliasing was not compared"
    bpy.data.objects.remove(fine)


STRETCH = np.array([1.0, 0.4, 1.6])


def compare_covered(item: bpy.types.Object, cloud: SplatCloud) -> None:
    """An object, stretched, as `covered` has it."""
    item.matrix_world = Matrix.LocRotScale(None, None, Vector(STRETCH))
    got, wanted = seen(item)[..., 3], covered(cloud)
    item.matrix_world = Matrix()
    assert psnr(got, wanted) > 45, psnr(got, wanted)


def covered(cloud: SplatCloud, *, antialiased: bool | None = None) -> np.ndarray:
    """(H, W) alpha of the stretched Gaussians in `seen`, computed the long way."""
    antialiased = cloud.antialiased if antialiased is None else antialiased
    focal, view = 0.4 * SIDE * DISTANCE, np.array(Matrix.Translation((0, 0, -DISTANCE)) @ TURN)
    left = np.ones((SIDE, SIDE))
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    for mean, quat, scale, opacity in zip(
        cloud.means, cloud.quats, cloud.scales, cloud.opacities, strict=True
    ):
        w, *v = (float(value) for value in quat)
        cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        axes = np.eye(3) + 2 * w * cross + 2 * cross @ cross  # Rodrigues
        t = view[:3, :3] @ (STRETCH * mean) + view[:3, 3]
        depth = -t[2]
        jacobian = focal / depth * np.array([[1, 0, t[0] / depth], [0, 1, t[1] / depth]])
        shape = jacobian @ view[:3, :3] @ (STRETCH[:, None] * axes * scale)
        blurred = shape @ shape.T + 0.3 * np.eye(2)
        if antialiased:
            opacity = opacity * np.prod(np.linalg.svd(shape)[1]) / np.sqrt(np.linalg.det(blurred))
        inverse = np.linalg.inv(blurred)
        dx = x - (focal * t[0] / depth + SIDE / 2 + 3)
        dy = (SIDE - y) - (focal * t[1] / depth + SIDE / 2)
        power = inverse[0, 0] * dx * dx + 2 * inverse[0, 1] * dx * dy + inverse[1, 1] * dy * dy
        alpha = np.minimum(0.999, opacity * np.exp(-0.5 * power))
        left *= np.where(alpha < 1 / 255, 1, 1 - alpha)
    return 1 - left


def check_depth(a: bpy.types.Object, _b: bpy.types.Object) -> None:
    """Surfaces in front hide splats, pixel by pixel, and only those behind."""
    view = Matrix.Translation((0, 0, -DISTANCE)) @ TURN
    focal = 0.4 * SIDE * DISTANCE
    camera = {"width": SIDE, "height": SIDE, "fx": focal, "fy": focal}
    clip = perspective({**camera, "cx": SIDE / 2, "cy": SIDE / 2}, 0.1, 100)
    middle = clip @ Vector((0, 0, -DISTANCE, 1))
    wall = np.ones((SIDE, SIDE), np.float32)
    wall[:, : SIDE // 2] = 0.5 + 0.5 * middle.z / middle.w
    pictures = {}
    for name, depth in {"free": None, "wall": wall, "shut": 0 * wall}.items():
        offscreen = gpu.types.GPUOffScreen(SIDE, SIDE, format="RGBA32F")
        with offscreen.bind():
            gpu.state.active_framebuffer_get().clear(color=(0.0, 0.0, 0.0, 0.0))
            held = None if depth is None else targets.Depth(targets.texture(depth, "R32F"), name)
            size = (SIDE, SIDE)
            draw.painter().draw(marked([a]), View(view, clip, size), key=0, depth=held, wait=True)
            data = offscreen.texture_color.read()
        data.dimensions = SIDE * SIDE * 4
        pictures[name] = np.array(data).reshape(SIDE, SIDE, 4)
        offscreen.free()
    half = SIDE // 2
    assert not pictures["shut"].any()
    assert (pictures["wall"][:, half:] == pictures["free"][:, half:]).all()
    covered, free = pictures["wall"][:, :half, 3], pictures["free"][:, :half, 3]
    assert (covered <= free + 1e-3).all() and 0.3 < covered.sum() / free.sum() < 0.95


def check_coarse(a: bpy.types.Object, _b: bpy.types.Object) -> None:
    """A slow view is coarse while it changes, then exactly what it was; the same is not redrawn."""
    focal = 0.4 * SIDE * DISTANCE
    camera = {"width": SIDE, "height": SIDE, "fx": focal, "fy": focal, "cx": SIDE / 2}
    clip = perspective({**camera, "cy": SIDE / 2}, 0.1, 100)
    painter, blended = Painter(), []
    blend = painter._blend
    painter._blend = lambda *given: blended.append(given[3]) or blend(*given)

    def look(
        x: float, depth: float | None = None, **how: bool
    ) -> tuple[np.ndarray, bool, list[tuple[int, int]]]:
        blended.clear()
        view = View(Matrix.Translation((x, 0, -DISTANCE)) @ TURN, clip, (SIDE, SIDE))
        offscreen = gpu.types.GPUOffScreen(SIDE, SIDE, format="RGBA32F")
        held = depth and targets.Depth(
            targets.texture(np.full((SIDE, SIDE), depth, np.float32), "R32F"), depth
        )
        with offscreen.bind():
            gpu.state.active_framebuffer_get().clear(color=(0.0, 0.0, 0.0, 0.0))
            coarse = painter.draw(marked([a]), view, key=0, depth=held or None, **how)
            data = offscreen.texture_color.read()
        data.dimensions = SIDE * SIDE * 4
        offscreen.free()
        return np.array(data).reshape(SIDE, SIDE, 4), coarse, list(blended)

    full, whole = {x: look(x, wait=True)[0] for x in (0.0, 0.3)}, (SIDE, SIDE)
    look(0.0, wait=True)
    quick = pace.QUICK
    try:
        again = look(0.0)
        assert not again[2] and (again[0] == full[0.0]).all()
        pace.QUICK = 100.0
        for x in (0.3, 0.0):  # on a fast GPU
            got, coarse, drawn = look(x, rested=False)
            assert (got == full[x]).all() and not coarse and drawn == [whole]
        pace.QUICK = 1e-9
        got, coarse, drawn = look(0.3)
        assert coarse and drawn == [(SIDE // 3, SIDE // 3)]
        assert 20 < psnr(got, full[0.3]) < 60, psnr(got, full[0.3])
        got, coarse, drawn = look(0.3, rested=False)
        assert not coarse and not drawn and psnr(got, full[0.3]) < 60
        got, coarse, drawn = look(0.3)
        assert (got == full[0.3]).all() and not coarse and drawn == [whole]
        assert look(0.3, depth=0.5)[2] and not look(0.3, depth=0.5, rested=False)[2]
        assert look(0.3, depth=0.9)[2], "another depth, the same picture"
    finally:
        pace.QUICK = quick
        painter.close()


def check_points(_a: bpy.types.Object, _b: bpy.types.Object) -> None:
    """Points have their colours, size and depth; changes and hiding are followed."""
    shown = np.array([[1, 0, 0], [0, 0.5, 1], [0.1, 0.1, 0.1]], np.float32)
    places = np.array([[0, 0, 0], [0.5, 0, 0], [0, 0, -2]], np.float32)  # the last behind the first
    cloud = clouds.new_points("points", places)
    colour = np.column_stack((clouds.to_linear(shown), np.ones(3, np.float32)))
    clouds.set_attribute(cloud.data, clouds.COLOUR, "FLOAT_COLOR", colour)
    clouds.show_as_points(cloud, clouds.colour_material("points"), 0.1)
    bpy.context.scene.collection.objects.link(cloud)
    focal = SIDE * DISTANCE
    camera = {"width": SIDE, "height": SIDE, "fx": focal, "fy": focal}
    clip = perspective({**camera, "cx": SIDE / 2, "cy": SIDE / 2}, 0.1, 100)

    def look(smallest: float = 1.0) -> np.ndarray:
        bpy.context.view_layer.update()
        offscreen = gpu.types.GPUOffScreen(SIDE, SIDE, format="RGBA32F")
        with offscreen.bind():
            gpu.state.active_framebuffer_get().clear(color=(0.0, 0.0, 0.0, 0.0), depth=1.0)
            view = Matrix.Translation((0, 0, -DISTANCE))
            points.draw(cloud, view, clip, SIDE, smallest=smallest)
            data = offscreen.texture_color.read()
        data.dimensions = SIDE * SIDE * 4
        offscreen.free()
        return np.array(data, np.float32).reshape(SIDE, SIDE, 4)

    middle, right = (SIDE // 2, SIDE // 2), (SIDE // 2, SIDE - 2)
    first = look()
    np.testing.assert_allclose(first[middle], [1, 0, 0, 1], atol=2e-3)
    np.testing.assert_allclose(first[right], [0, 0.5, 1, 1], atol=2e-3)
    red = (first[..., 0] > 0.9).sum()
    across = 0.2 * SIDE * DISTANCE / (DISTANCE - 0.1) + 1
    assert 0.9 < red / (np.pi / 4 * across**2) < 1.1, red
    cloud.scale = (0.5, 0.5, 0.5)
    assert 0.2 < (look()[..., 0] > 0.9).sum() / red < 0.35
    assert (look(smallest=40.0)[..., 0] > 0.9).sum() > 2 * red
    cloud.scale = (1, 1, 1)
    cloud.data.vertices[0].co.x = -0.4
    cloud.data.update()
    moved = look()
    np.testing.assert_allclose(moved[middle], [0.1, 0.1, 0.1, 1], atol=2e-3)
    assert (moved[..., 0] > 0.9).any() and not (moved[middle] == first[middle]).all()
    cloud.modifiers[clouds.POINTS].show_viewport = False
    assert not look().any()
    bpy.data.objects.remove(cloud)


def check_scenes(a: bpy.types.Object, b: bpy.types.Object) -> None:
    """A scene shows its own objects; those of another stay loaded."""
    alone = seen(a)
    other = bpy.data.scenes.new("other")
    bpy.context.scene.collection.objects.unlink(b)
    other.collection.objects.link(b)
    assert [item.visible for item in splat_objects(bpy.context)] == [True, False]
    assert (seen(a, b) == alone).all()
    other.collection.objects.unlink(b)
    bpy.context.scene.collection.objects.link(b)
    bpy.data.scenes.remove(other)


def check_freed(a: bpy.types.Object, _b: bpy.types.Object) -> None:
    """Nothing stays in memory; drawing can start again."""
    before = seen(a)
    draw.unregister()
    draw.unregister()
    draw.register()  # in background mode there is nothing to register
    assert (seen(a) == before).all()
    draw.painter().forget()
    assert (seen(a) == before).all()
    # Blender once drew with a program that was gone, when the new one lay where that had lain.
    first = glance(a, 1.0, Painter(), wait=True)
    for _ in range(12):
        assert (glance(a, 1.0, Painter(), wait=True) == first).all()


if __name__ == "__main__":
    run_checks(globals())
