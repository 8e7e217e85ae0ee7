"""Gaussians as attributes of a mesh's points (docs/conventions.md), and back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..geometry.common_map import common_map
from ..geometry.frames import Matrix
from ..geometry.splat_cloud import SH_C0, SplatCloud
from . import clouds

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import AttributeTypeItems

Float32 = NDArray[np.float32]
Points = bpy.types.Mesh | bpy.types.PointCloud

WIDTHS = {"FLOAT": 1, "FLOAT_VECTOR": 3, "FLOAT_COLOR": 4, "QUATERNION": 4}
SHAPE = ("scale", "rotation", "radiance:base")
"""Attributes that every Gaussian has; opacity is the last number of the third."""

PLACE = "imported"
"""Attribute: where a point was imported."""


FRAME = "roigs_frame"
"""Custom property of a mesh: the map from its file's frame to its own, as it was imported."""

ANTIALIASED = "antialiased"
"""Attribute of Gaussians that are drawn with anti-aliasing; others have none, or False.

It is each point's own, so that meshes that are joined do not lose it.
"""


def imported_frame(mesh: bpy.types.Mesh) -> Matrix:
    """(4, 4) from the frame of a mesh's file to its own, before any edit."""
    stored: Any = mesh.get(FRAME)
    return np.eye(4) if stored is None else np.array(stored, np.float64).reshape(4, 4)


def move_to_frame(mesh: bpy.types.Mesh, frame: Matrix) -> None:
    """Move the points of a mesh, which are in their file's frame, to another one."""
    means = clouds.positions_of(mesh) @ frame[:3, :3].T + frame[:3, 3]
    mesh.vertices.foreach_set("co", means.astype(np.float32).ravel())
    mesh[FRAME] = frame.ravel().tolist()
    mesh.update()


def add_attributes(mesh: bpy.types.Mesh, cloud: SplatCloud) -> None:
    """Add the attributes that docs/conventions.md lists, and those of the points' material."""
    base = cloud.sh[:, 0]
    radiance = np.column_stack((base, cloud.opacities))
    colour = np.ones((len(base), 4), np.float32)
    colour[:, :3] = clouds.to_linear(np.clip(0.5 + SH_C0 * base, 0, 1))
    columns: dict[str, tuple[AttributeTypeItems, Float32]] = {
        clouds.COLOUR: ("FLOAT_COLOR", colour),
        "opacity": ("FLOAT", cloud.opacities),
        "radius": ("FLOAT", np.cbrt(cloud.scales.prod(axis=1))),
        "scale": ("FLOAT_VECTOR", cloud.scales),
        "rotation": ("QUATERNION", cloud.quats),
        "radiance:base": ("FLOAT_COLOR", radiance),  # four numbers, in any Blender
        PLACE: ("FLOAT_VECTOR", cloud.means),
    }
    for index in range(1, cloud.sh.shape[1]):
        columns[_sh_name(index)] = ("FLOAT_VECTOR", cloud.sh[:, index])
    for name, (kind, numbers) in columns.items():
        clouds.set_attribute(mesh, name, kind, numbers)
    if cloud.antialiased:
        mark_antialiased(mesh)


def cloud_of(mesh: bpy.types.Mesh) -> tuple[SplatCloud, Matrix] | None:
    """The Gaussians of a mesh in their file's frame, and the map (4, 4) that all went through.

    Without points that are hidden in edit mode or have no size. Those without a size were added to
    the mesh, as by joining with another one. What most of them are decides on anti-aliasing.

    None if an attribute is missing, as after joining into another mesh or applying a modifier.
    """
    shape = [values(mesh, name) for name in SHAPE]
    scales, quats, radiance = shape
    if scales is None or quats is None or radiance is None:
        return None
    means = clouds.positions_of(mesh)
    there = drawn(mesh)
    imported = values(mesh, PLACE)
    applied = imported_frame(mesh)
    if imported is not None:
        placed = imported[there] @ applied[:3, :3].T + applied[:3, 3]
        applied = common_map(placed, means[there]) @ applied
    back = np.linalg.inv(applied)
    cloud = SplatCloud(
        means=(means[there] @ back[:3, :3].T + back[:3, 3]).astype(np.float32),
        quats=quats[there],
        scales=scales[there],
        opacities=radiance[there, 3],
        sh=sh_of(mesh)[there],
        antialiased=antialiased_share(mesh, there) > 0.5,
    )
    return cloud, applied


def mark_antialiased(data: Points) -> None:
    """All points of a mesh or point cloud are Gaussians that are drawn with anti-aliasing."""
    attribute: Any = data.attributes.new(ANTIALIASED, "BOOLEAN", "POINT")
    attribute.data.foreach_set("value", np.ones(len(attribute.data), np.bool_))


def antialiased_share(data: Points, there: NDArray[np.bool_] | None = None) -> float:
    """The share of points, of those that are `there`, that are drawn with anti-aliasing."""
    attribute: Any = data.attributes.get(ANTIALIASED)
    if attribute is None or attribute.domain != "POINT" or attribute.data_type != "BOOLEAN":
        return 0.0
    found = np.empty(len(attribute.data), np.bool_)
    attribute.data.foreach_get("value", found)
    of_those = found if there is None else found[there]
    return float(of_those.mean()) if len(of_those) else 0.0


def sh_of(data: Points) -> Float32:
    """(N, K, 3) SH coefficients of points that have `SHAPE`, of whole degrees only."""
    radiance = values(data, "radiance:base")
    assert radiance is not None
    sh = [radiance[:, :3]]
    while len(sh) < 16 and (band := values(data, _sh_name(len(sh)))) is not None:
        sh.append(band)
    degree = int(np.sqrt(len(sh)))
    return np.stack(sh[: degree**2], axis=1)


def drawn(mesh: bpy.types.Mesh) -> NDArray[np.bool_]:
    """(N,) which points are drawn as Gaussians: those that `cloud_of` has."""
    scales, means = values(mesh, "scale"), clouds.positions_of(mesh)
    sized = np.zeros(len(means), bool) if scales is None else scales.any(axis=1)
    return np.asarray(~hidden(mesh) & sized & np.isfinite(means).all(axis=1))


def values(data: Points, name: str) -> Float32 | None:
    """(N, numbers) of a point attribute; None if there is none of that name."""
    attribute: Any = data.attributes.get(name)
    if attribute is None or attribute.domain != "POINT" or attribute.data_type not in WIDTHS:
        return None
    width = WIDTHS[attribute.data_type]
    points = data.vertices if isinstance(data, bpy.types.Mesh) else data.points
    flat = np.empty(width * len(points), np.float32)
    attribute.data.foreach_get(clouds.ATTRIBUTE_KEYS[attribute.data_type], flat)
    return flat.reshape(-1, width)


def hidden(mesh: bpy.types.Mesh) -> NDArray[np.bool_]:
    """(N,) whether a point was hidden in edit mode."""
    found = np.empty(len(mesh.vertices), np.bool_)
    mesh.vertices.foreach_get("hide", found)
    return found


def _sh_name(index: int) -> str:
    return f"radiance:sh_{index - 1}"
