"""Makes the surface of a box from end to end: depth maps, field, mesh, texture."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..context import QUIET, Context
from ..formats.events import StageStarted
from ..formats.text import counted
from ..machine import package
from ..model.gaussians import Gaussians
from ..model.roi import OrientedBox
from ..model.scene import PosedImage, SfmScene
from ..photos.decode import load_photo
from .depth import DepthMap, box_window, depth_maps
from .fusion import footprint, fuse
from .memory import BETTER, FINER, SurfacePlan, pixel_size, plan_surface
from .mesh import Mesh, mesh_of, nothing_there, simplified
from .objects import cut_off, has_masks, painted, support_of
from .photo_fit import fitted
from .texture import Load, Textured, texture_side, textured

PACKAGES = {
    "skimage.measure": "scikit-image",
    "fast_simplification": "fast-simplification",
    "trimesh": "trimesh",
}
STAGE, STEPS = "mesh", 2
FACES = 100_000
DENSEST = 20
"""Most faces of the field's surface for one of the finished mesh. More would take minutes to clean
and to simplify. Then thousands of edges of a closed mesh would meet, and it would not stay closed.
"""
MOST_PHOTOS = 150
NEAR_SIDE = 0.02  # distance from a box's sides, of its size; ..
CUT = 0.002  # .. largest share of vertices so near to the sides if the box contains the object
FEWEST = 5  # photos; with fewer, much of the surface stays open


@dataclass(frozen=True, kw_only=True)
class SurfaceOptions:
    """Options of a surface.

    Attributes:
        faces: most faces of the mesh.
        watertight: whether the mesh has no holes.
        texture_size: side of the texture, texels; None: by the resolution of the photos.
    """

    faces: int = FACES
    watertight: bool = False
    texture_size: int | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """The surface of a box, and how it was made.

    Attributes:
        textured: mesh and texture, in the frame of the scene.
        voxel: side of the field's voxels, units of the scene.
        photos: number of photos that show the box.
    """

    textured: Textured
    voxel: float
    photos: int

    @property
    def mesh(self) -> Mesh:
        """Return the mesh."""
        return self.textured.mesh

    @property
    def filled(self) -> float:
        """Return the share of the surface that no photo has shown."""
        areas = self.mesh.areas
        return float(areas[self.mesh.filled].sum() / max(areas.sum(), 1e-30))


def check_packages() -> None:
    """Raise EngineError if an optional package is not installed, before any work is done."""
    for module, name in PACKAGES.items():
        package(module, "A surface", name)


def make_surface(
    gaussians: Gaussians,
    scene: SfmScene,
    roi: OrientedBox,
    options: SurfaceOptions = SurfaceOptions(),
    *,
    plan: SurfacePlan | None = None,
    load: Load = load_photo,
    context: Context = QUIET,
) -> Surface:
    """Make the surface of a box.

    Args:
        gaussians: the trained scene, on the context's device.
        scene: the photos to use, in the frame of the Gaussians and the box. If some have masks of
            the box's object, the surface is that of the object alone.
        plan: plan of the memory; None: that of `surface_plan`.
        load: returns a photo, (H, W, 3) uint8 sRGB.

    Raises:
        SceneError: no photo shows a surface in the box.
        EngineError: an optional package is not installed.
        Stopped: on request.
    """
    plan = plan or surface_plan(gaussians, scene, roi)
    maps = _depth_maps(gaussians, scene, roi, plan, context)
    if not maps:
        raise nothing_there(roi)
    if len(maps) < FEWEST:
        context.warn(
            f"Only {counted(len(maps), 'photo')} show box '{roi.name}': much of its surface"
            " stays open."
        )
    voxel = voxel_size(maps, roi, plan, context)
    field = fuse(maps, roi, voxel, context)
    masked = has_masks(scene, roi)
    if masked and (support := support_of(maps, roi, voxel)) is not None:
        field = cut_off(field, support)
    started = time.monotonic()
    context.emit(StageStarted(stage=STAGE, total=STEPS))
    while field.faces > DENSEST * options.faces:
        field = field.halved()
    mesh = mesh_of(field, roi, maps, closed=options.watertight, context=context)
    voxel = field.voxel
    del field
    context.progress(STAGE, 1, STEPS, started)
    if masked and roi.scaled(1 - NEAR_SIDE).distance(mesh.vertices).astype(bool).mean() > CUT:
        context.warn(f"The box cuts object '{roi.name}': make the box larger.")
    context.check_cancelled()
    mesh = simplified(mesh, options.faces, context)
    context.progress(STAGE, STEPS, STEPS, started)
    mesh = fitted(mesh, maps, roi, load, context)
    side = min(options.texture_size or texture_side(mesh, maps), plan.texture)
    return Surface(
        textured=textured(mesh, maps, side, load, context), voxel=voxel, photos=len(maps)
    )


def _depth_maps(
    gaussians: Gaussians, scene: SfmScene, roi: OrientedBox, plan: SurfacePlan, context: Context
) -> list[DepthMap]:
    """Return the depth maps of the nearest photos, without empty ones."""
    masked = has_masks(scene, roi)
    drawn = painted(gaussians, scene, roi, context) if masked else gaussians
    photos = [image.name for image in nearest_photos(scene.images, roi)]
    found = depth_maps(drawn, scene, roi, photos, context, coarser=plan.coarser, masked=masked)
    return [depth_map for depth_map in found if depth_map.depth.any()]


def nearest_photos(images: Sequence[PosedImage], roi: OrientedBox) -> list[PosedImage]:
    """Return the photos that show a box; if there are many, those that show it largest."""
    shown = [image for image in images if box_window(roi, image) is not None]
    return sorted(shown, key=lambda image: pixel_size(image, roi))[:MOST_PHOTOS]


def surface_plan(gaussians: Gaussians, scene: SfmScene, roi: OrientedBox) -> SurfacePlan:
    """Plan the memory of `make_surface`."""
    return plan_surface(nearest_photos(scene.images, roi), roi, len(gaussians))


def voxel_size(
    maps: Sequence[DepthMap], roi: OrientedBox, plan: SurfacePlan, context: Context = QUIET
) -> float:
    """Return the side of a voxel: part of a pixel of the better photos, or what memory allows."""
    wanted = float(np.percentile([footprint(depth_map) for depth_map in maps], BETTER)) / FINER
    found = max(wanted, plan.voxel) if math.isfinite(wanted) else plan.voxel
    if found > wanted or plan.coarser > 1:
        context.warn(
            f"Box '{roi.name}' is large: its surface is {found / wanted * plan.coarser:.1f} times"
            " coarser than its photos. Use a smaller box for more detail."
        )
    return found
