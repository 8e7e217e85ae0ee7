"""Gaussians as attributes of a mesh's points (docs/conventions.md), and back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..geometry.common_map import common_map
from ..geometry.frames import Matrix
from ..geometry.splat_cloud import SH_C0, SplatCloud
from ..shared import splat_ply, targets
from . import clouds

if TYPE_CHECKING:
    from bpy.stub_internal.rna_enums import AttributeTypeItems

Float32 = NDArray[np.float32]
Points = bpy.types.Mesh | bpy.types.PointCloud

WIDTHS = {"FLOAT": 1, "FLOAT_VECTOR": 3, "FLOAT_COLOR": 4, "FLOAT4": 4, "QUATERNION": 4}
SHAPE = ("scale", "rotation", "radiance:base")
"""Attributes that every Gaussian has; opacity is the last number of the third."""

SH_NAMES = tuple(f"radiance:sh_{index}" for index in range(15))
"""Attributes with the view-dependent colour; a lower degree has fewer of them."""

PLACE = "imported"
"""Attribute with a point's imported position."""

NUMBERS = {
    **dict(zip(SHAPE, (3, 4, 4), strict=True)),
    **dict.fromkeys((*SH_NAMES, PLACE, "position"), 3),
    "opacity": 1,
}
"""Required number of values of these attributes; a user's .blend may have others."""


FAR = 1e15
"""Largest valid number in a frame, as for boxes and placements."""

FRAME = "roigs_frame"
"""Custom property of a mesh: the map from its file's frame to its own at import."""

PHOTO_FOCAL = "roigs_photo_focal"
"""Custom property: `SplatCloud.photo_focal`."""

MADE_FOR = ("antialiased", "linear_light")
"""Boolean attributes for properties of the Gaussians' target (`targets.Target`); absent is False.

They are stored per point, so that joined meshes keep them.
"""


def imported_frame(mesh: bpy.types.Mesh) -> Matrix:
    """(4, 4) from the frame of a mesh's file to its own, before any edit."""
    stored: Any = mesh.get(FRAME)
    if stored is None:
        return np.eye(4)
    try:
        frame = np.array(stored, np.float64).reshape(4, 4)
    except (ValueError, TypeError):
        return np.eye(4)
    # A .blend may hold anything; a map without an inverse is not ours.
    usable = (np.abs(frame) < FAR).all() and np.linalg.matrix_rank(frame[:3, :3]) == 3
    return frame if usable and (frame[3] == (0, 0, 0, 1)).all() else np.eye(4)


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
    for index, name in enumerate(SH_NAMES[: cloud.sh.shape[1] - 1], start=1):
        columns[name] = ("FLOAT_VECTOR", cloud.sh[:, index])
    for name, (kind, numbers) in columns.items():
        clouds.set_attribute(mesh, name, kind, numbers)
    mark_target(mesh, cloud.target)
    mark_photo_focal(mesh, cloud.photo_focal)


def cloud_of(mesh: bpy.types.Mesh) -> tuple[SplatCloud, Matrix] | None:
    """Return a mesh's Gaussians in their file's frame, and the common map (4, 4) of all points.

    Points that are hidden in edit mode or have no size are left out. Points without a size were
    added to the mesh, as by joining. The target is that of most points.

    None if an attribute is missing, as after joining into another mesh or applying a modifier.
    """
    shape = [values(mesh, name) for name in SHAPE]
    scales, quats, radiance = shape
    if scales is None or quats is None or radiance is None:
        return None
    means, there = clouds.positions_of(mesh), drawn(mesh)
    applied = applied_map(mesh)
    back = np.linalg.inv(applied)
    cloud = SplatCloud(
        means=(means[there] @ back[:3, :3].T + back[:3, 3]).astype(np.float32),
        quats=quats[there],
        scales=scales[there],
        opacities=radiance[there, 3],
        sh=sh_of(mesh)[there],
        target=targets_of(mesh, there)[0],
        photo_focal=photo_focal_of(mesh),
    )
    return cloud, applied


def applied_map(mesh: bpy.types.Mesh) -> Matrix:
    """(4, 4) from the file's frame to where most Gaussians of a mesh are now."""
    frame, imported, there = imported_frame(mesh), values(mesh, PLACE), drawn(mesh)
    if imported is None:
        return frame
    placed = imported[there] @ frame[:3, :3].T + frame[:3, 3]
    return common_map(placed, clouds.positions_of(mesh)[there]) @ frame


def mark_target(data: Points, target: targets.Target) -> None:
    """Mark all points of a mesh or point cloud as Gaussians made for a target."""
    for name in MADE_FOR:
        if getattr(target, name) and name not in data.attributes:
            attribute: Any = data.attributes.new(name, "BOOLEAN", "POINT")
            attribute.data.foreach_set("value", np.ones(len(attribute.data), np.bool_))


def mark_photo_focal(data: Points, photo_focal: float | None) -> None:
    """Store the focal length of the photos; None if it is unknown."""
    if photo_focal is not None:
        data[PHOTO_FOCAL] = photo_focal


def photo_focal_of(data: Points) -> float | None:
    """Return the stored focal length if it is valid: a .blend may hold anything."""
    stored: Any = data.get(PHOTO_FOCAL)
    return splat_ply.usable_focal(stored) if isinstance(stored, float) else None


def marked_target(data: Points) -> targets.Target:
    """Return the target from the names of the attributes alone. Fast; for points of one target."""
    smooth, linear = (name in data.attributes for name in MADE_FOR)
    return targets.target_with(antialiased=smooth, linear_light=linear)


def targets_of(data: Points, there: NDArray[np.bool_] | None = None) -> list[targets.Target]:
    """Return the targets of the points in the mask `there`, that of most points first."""
    smooth, linear = (_flags(data, name) for name in MADE_FOR)
    kinds = 2 * linear + smooth if there is None else (2 * linear + smooth)[there]
    counts = np.bincount(kinds, minlength=4)
    order = [kind for kind in np.argsort(-counts, kind="stable").tolist() if counts[kind]]
    return [
        targets.target_with(antialiased=bool(kind & 1), linear_light=bool(kind & 2))
        for kind in order or [0]
    ]


def _flags(data: Points, name: str) -> NDArray[np.int64]:
    """(N,) 1 where a boolean attribute is true; 0 elsewhere, and without the attribute."""
    attribute: Any = data.attributes.get(name)
    points = data.vertices if isinstance(data, bpy.types.Mesh) else data.points
    found = np.zeros(len(points), np.bool_)
    if attribute and attribute.domain == "POINT" and attribute.data_type == "BOOLEAN":
        attribute.data.foreach_get("value", found)
    return found.astype(np.int64)


def sh_of(data: Points) -> Float32:
    """(N, K, 3) SH coefficients of points that have `SHAPE`; only complete degrees."""
    radiance = values(data, "radiance:base")
    assert radiance is not None
    sh = [radiance[:, :3]]
    for name in SH_NAMES:
        if (band := values(data, name)) is None:
            break
        sh.append(band)
    degree = int(np.sqrt(len(sh)))
    return np.stack(sh[: degree**2], axis=1)


def drawn(mesh: bpy.types.Mesh) -> NDArray[np.bool_]:
    """(N,) which points are drawn as Gaussians: those that `cloud_of` has."""
    scales, means = values(mesh, "scale"), clouds.positions_of(mesh)
    sized = np.zeros(len(means), bool) if scales is None else scales.any(axis=1)
    return np.asarray(~hidden(mesh) & sized & np.isfinite(means).all(axis=1))


def values(data: Points, name: str) -> Float32 | None:
    """(N, numbers) values of a point attribute; None if it is missing or of another type."""
    attribute: Any = data.attributes.get(name)
    if attribute is None or attribute.domain != "POINT" or attribute.data_type not in WIDTHS:
        return None
    width = WIDTHS[attribute.data_type]
    if width != NUMBERS.get(name, width):
        return None
    points = data.vertices if isinstance(data, bpy.types.Mesh) else data.points
    flat = np.empty(width * len(points), np.float32)
    attribute.data.foreach_get(clouds.ATTRIBUTE_KEYS[attribute.data_type], flat)
    return flat.reshape(-1, width)


def hidden(mesh: bpy.types.Mesh) -> NDArray[np.bool_]:
    """(N,) whether a point was hidden in edit mode."""
    found = np.empty(len(mesh.vertices), np.bool_)
    mesh.vertices.foreach_get("hide", found)
    return found
