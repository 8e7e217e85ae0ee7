"""The surface of a box from end to end: depth maps, field, mesh, texture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..context import QUIET, Context
from ..formats.text import counted
from ..machine import machine_memory, package
from ..model.gaussians import Gaussians
from ..model.roi import OrientedBox
from ..model.scene import PosedImage, SfmScene
from ..photos.decode import load_photo
from .depth import DepthMap, box_window, depth_maps
from .fusion import COARSE, footprint, fuse
from .mesh import Mesh, mesh_of, nothing_there, simplified
from .texture import Load, Textured, texture_side, textured

PACKAGES = {
    "skimage.measure": "scikit-image",
    "fast_simplification": "fast-simplification",
    "trimesh": "trimesh",
}
FACES = 100_000
MOST_PHOTOS = 150
FINER = 2.0  # voxels in a pixel of the better photos
BETTER = 25  # percentile of the photos' pixels
FEWEST = 5  # photos: with fewer, much stays open
PER_VOXEL = 30  # bytes while a field is fused and cut out
MEMORY_SHARE = 4  # a field takes at most 1/4 of the machine's memory
MOST_VOXELS = 1 << 27


@dataclass(frozen=True, kw_only=True)
class SurfaceOptions:
    """What a surface is to be.

    Attributes:
        faces: of the mesh, at most.
        watertight: whether it gets no holes.
        texture_size: side of the texture, texels; None: as the photos resolve.
    """

    faces: int = FACES
    watertight: bool = False
    texture_size: int | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """The surface of a box, and what it was made of.

    Attributes:
        textured: mesh and texture, in the frame of the scene.
        voxel: side of the field's voxels, units of the scene.
        photos: how many have shown the box.
    """

    textured: Textured
    voxel: float
    photos: int

    @property
    def mesh(self) -> Mesh:
        """The mesh."""
        return self.textured.mesh

    @property
    def filled(self) -> float:
        """Share of the surface that no photo has shown."""
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
    load: Load = load_photo,
    context: Context = QUIET,
) -> Surface:
    """The surface of a box.

    Args:
        gaussians: the trained scene, on the context's device.
        scene: the photos to use, in the frame of the Gaussians and the box.
        load: returns a photo, (H, W, 3) uint8 sRGB.

    Raises:
        SceneError: no photo shows a surface in the box.
        EngineError: an optional package is not installed.
        Stopped: on request.
    """
    photos = nearest_photos(scene.images, roi)
    maps = list(depth_maps(gaussians, scene, roi, photos, context))
    maps = [depth_map for depth_map in maps if depth_map.depth.any()]
    if not maps:
        raise nothing_there(roi)
    if len(maps) < FEWEST:
        context.warn(
            f"Only {counted(len(maps), 'photo')} show box '{roi.name}': much of its surface"
            " stays open."
        )
    voxel = voxel_size(maps, roi, context)
    field = fuse(maps, roi, voxel, context)
    mesh = mesh_of(field, roi, closed=options.watertight, context=context)
    context.check_cancelled()
    mesh = simplified(mesh, options.faces)
    side = options.texture_size or texture_side(mesh, maps)
    return Surface(
        textured=textured(mesh, maps, side, load, context), voxel=voxel, photos=len(maps)
    )


def nearest_photos(images: Sequence[PosedImage], roi: OrientedBox) -> list[str]:
    """Names of the photos that show a box, those that show it largest if there are many."""
    shown = [image for image in images if box_window(roi, image) is not None]

    def pixel(image: PosedImage) -> float:
        away = float(np.linalg.norm(image.centre - roi.centre))
        return away / max(image.camera.fx, image.camera.fy)

    return [image.name for image in sorted(shown, key=pixel)[:MOST_PHOTOS]]


def voxel_size(maps: Sequence[DepthMap], roi: OrientedBox, context: Context = QUIET) -> float:
    """Side of a voxel: part of a pixel of the better photos, or as memory allows."""
    pixels = [footprint(depth_map) for depth_map in maps]
    wanted = float(np.percentile(pixels, BETTER)) / FINER
    most = min(MOST_VOXELS, machine_memory() // MEMORY_SHARE // PER_VOXEL)
    volume = float(np.prod(2 * roi.half_extents))
    # Cells at the box's sides reach beyond it.
    possible = float((volume / most) ** (1 / 3)) * (1 + COARSE / 100)
    if possible > wanted:
        context.warn(
            f"Box '{roi.name}' is large: its surface is {possible / wanted:.1f} times coarser than"
            " its photos. Use a smaller box for more detail."
        )
    return max(wanted, possible) if math.isfinite(wanted) else possible
