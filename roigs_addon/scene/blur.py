"""Depth of field and motion blur of a frame: the engine averages several sharp pictures.

Each picture has its own point of the camera's aperture, its own moment of the shutter time, and the
surfaces of that moment. So Gaussians and meshes blur alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..blender import camera_of
from ..geometry.aperture import Aperture
from . import display, frame_request, lookup, shadow_pass, surfaces

MOMENTS = 16
NEAREST_FOCUS = 1e-5
NOT_MOVED = (
    "Gaussians have no motion blur in this render: switch on Render ▸ Lock Interface, or render"
    " without a window."
)


@dataclass(frozen=True, kw_only=True)
class Moment:
    """A moment of a frame: the engine's request without the path of its output."""

    request: dict[str, Any]
    surfaces: NDArray[np.float32]  # (T, 3, 3) in the world
    aperture: Aperture | None


def moment(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> Moment | None:
    """Return the frame's content at the depsgraph's time; None without Gaussians.

    Raises:
        AddonError: as `frame_request`.
    """
    request = frame_request.frame_request(scene, depsgraph, "")
    if request is None or scene.camera is None:
        return None
    found = surfaces.triangles(depsgraph)
    return Moment(request=request, surfaces=found, aperture=_aperture(scene.camera, depsgraph))


def moments(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> list[Moment]:
    """Return the moments whose sharp pictures are averaged; empty if one plain picture is enough.

    This steps through the scene's time, and restores it.

    Args:
        scene: the rendered scene.
        depsgraph: the render's, at the frame.

    Raises:
        AddonError: as `moment` does.
    """
    found: list[Moment | None] = []
    if _is_panoramic(scene):
        return []
    if _moves(scene) and _may_step(scene) and display.in_layer(scene):
        found = _in_shutter(scene, depsgraph)
    if not found and _is_needed(scene, depsgraph):
        found = [moment(scene, depsgraph)]
    return [each for each in found if each is not None]


def remark(
    scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, moments: Sequence[Moment]
) -> str:
    """Return a one-line warning about a frame averaged from moments; empty if there is none."""
    if _is_panoramic(scene):
        return "Gaussians have no motion blur in panoramas." if _moves(scene) else ""
    if _moves(scene) and not _may_step(scene):
        return NOT_MOVED
    if scene.render.film_transparent:
        return ""
    if _hides(scene, depsgraph):
        return "Shadow catchers show no shadow on Gaussians: switch on Render ▸ Film ▸ Transparent."
    blurred = len(moments) > 1 or any(each.aperture for each in moments)
    if blurred and any(len(each.surfaces) for each in moments):
        return (
            "Blurred meshes have rims in the World's colour: switch on Render ▸ Film ▸ Transparent."
        )
    return ""


def _is_needed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether a plain picture cannot be compared with Blender's depth, even without motion."""
    camera = scene.camera
    if camera is None or camera.type != "CAMERA":
        return False
    catches = not scene.render.film_transparent and _hides(scene, depsgraph)
    return catches or camera_of(camera).type == "ORTHO" or _aperture(camera, depsgraph) is not None


def _hides(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> bool:
    """Whether Blender's opaque picture shows the world's background in place of a catcher."""
    return surfaces.have_catcher(depsgraph) and not shadow_pass.multiplies(scene)


def _is_panoramic(scene: bpy.types.Scene) -> bool:
    camera = scene.camera
    return camera is not None and camera.type == "CAMERA" and camera_of(camera).type == "PANO"


def _moves(scene: bpy.types.Scene) -> bool:
    """Whether the frame is to have motion blur."""
    return scene.render.use_motion_blur and scene.render.motion_blur_shutter > 0


def _may_step(scene: bpy.types.Scene) -> bool:
    """Whether the scene's time can be changed during a render."""
    return bpy.app.background or scene.render.use_lock_interface


def _in_shutter(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> list[Moment | None]:
    """Return the moments within the shutter time; empty if nothing moves."""
    first, *between, last = _times(scene)
    with _time_kept(scene, depsgraph):
        ends = [_at(scene, depsgraph, time) for time in (first, last)]
        if _alike(ends):
            return []
        return [ends[0], *(_at(scene, depsgraph, time) for time in between), ends[1]]


def request(moments: Sequence[Moment], out: Path, *, transparent: bool) -> dict[str, Any]:
    """Return the engine's request (docs/files.md) to average moments and points of apertures.

    Args:
        moments: at least one.
        out: path of the engine's files; the surfaces' files are written beside it.
        transparent: whether Blender's film is.
    """
    files, last = [], np.zeros((0, 3, 3), np.float32)
    for number, each in enumerate(moments):
        if number == 0 or not np.array_equal(each.surfaces, last):
            last = each.surfaces
            path = str(out.with_name(f"{out.name}-{number}.npy")) if len(last) else ""
            if path:
                np.save(path, last)
        files.append(path)
    aperture = moments[0].aperture
    count = len(moments)
    if aperture is not None:
        count = max(count, aperture.count(moments[0].request["camera"]["fx"]))
    points = [each.aperture.points(count) if each.aperture else None for each in moments]
    samples = []
    for k in range(count):
        row = k * len(moments) // count
        now, opening = moments[row], points[row]
        sample = {key: now.request[key] for key in ("camera", "models")}
        if now.aperture is not None and opening is not None:
            sample["camera"] = now.aperture.through(sample["camera"], opening[k])
        if files[row]:
            sample["surfaces"] = files[row]
        samples.append(sample)
    return {"samples": samples, "transparent": transparent, "out": str(out)}


def _aperture(camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Aperture | None:
    """Return a camera's aperture; None without depth of field."""
    item = camera.evaluated_get(depsgraph)
    data = camera_of(item)
    dof = data.dof
    if dof is None or not dof.use_dof or data.type != "PERSP" or not dof.aperture_fstop > 0:
        return None
    focus = dof.focus_distance
    if dof.focus_object is not None:
        target = lookup.matrix_world(dof.focus_object.evaluated_get(depsgraph))[:3, 3]
        matrix = lookup.matrix_world(item)
        axis = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
        focus = abs(float(axis @ (target - matrix[:3, 3])))
    return Aperture(
        radius=data.lens * 1e-3 / (2 * dof.aperture_fstop),
        focus=max(focus, NEAREST_FOCUS),
        blades=dof.aperture_blades,
        rotation=dof.aperture_rotation,
        ratio=dof.aperture_ratio,
    )


def _times(scene: bpy.types.Scene) -> list[float]:
    """Evenly spaced frames in the shutter's time: the middles of its parts."""
    shutter = scene.render.motion_blur_shutter
    begin = {"START": 0.0, "CENTER": -shutter / 2, "END": -shutter}[_position(scene)]
    shares = (np.arange(MOMENTS) + 0.5) / MOMENTS
    return [scene.frame_float + begin + shutter * float(share) for share in shares]


def _position(scene: Any) -> str:
    """Return the shutter's position; in older Blenders only Cycles has the setting."""
    of_cycles = getattr(scene, "cycles", None)
    old = getattr(of_cycles, "motion_blur_position", "CENTER")
    return str(getattr(scene.render, "motion_blur_position", old))


def _at(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, time: float) -> Moment | None:
    scene.frame_float = time
    depsgraph.update()
    return moment(scene, depsgraph)


def _alike(ends: Sequence[Moment | None]) -> bool:
    """Whether nothing moves between two moments, or one shows no Gaussians."""
    first, last = ends
    if first is None or last is None:
        return True
    same = first.request["models"] == last.request["models"]
    poses = [each.request["camera"]["world_to_camera"] for each in (first, last)]
    return same and poses[0] == poses[1] and np.array_equal(first.surfaces, last.surfaces)


@contextmanager
def _time_kept(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> Iterator[None]:
    """Restore the frame at the end, and tag again what the renderer must see as changed."""
    time, changed = scene.frame_float, [each.id for each in depsgraph.updates]
    originals = [each.original for each in changed if each is not None]
    try:
        yield
    finally:
        scene.frame_float = time
        depsgraph.update()
        if scene.render.use_persistent_data:
            for each in filter(None, originals):
                each.update_tag()
