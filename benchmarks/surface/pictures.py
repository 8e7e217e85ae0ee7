"""A textured mesh on test photos, beside the Gaussians that it was made from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from roigs_engine.evaluation.metrics import flip, mean_in, psnr_from_mse, squared_error
from roigs_engine.machine import package
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, Float64, PosedImage, project
from roigs_engine.photos.decode import load_photo
from roigs_engine.rasterize.instances import surface_depth
from roigs_engine.rasterize.view import render_view

from .distances import Triangles

LEAST = 1024  # pixels of the object; photos with fewer are left out
FINER = 3  # samples of a pixel, in each direction
NEAR = 0.01  # metres before the camera; triangles that begin nearer are not drawn
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""From the axes of glTF to those of the demo."""

Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Mesh:
    """A mesh with colours.

    Attributes:
        vertices, faces: (V, 3) in the scene's frame, (F, 3).
        uv: (V, 2) where the texture has a vertex's colour, from its upper left corner, 0 to 1.
        texture: (H, W, 3) in [0, 1]; None: `colours`.
        colours: (V, 3) in [0, 1]; with a texture, its colours there.
        components: connected ones.
    """

    vertices: Float64
    faces: Ints
    uv: Float64 | None
    texture: Float64 | None
    colours: Float64
    components: int

    @property
    def triangles(self) -> Triangles:
        """(F, 3, 3)"""
        return self.vertices[self.faces].astype(np.float32)


@dataclass(frozen=True, kw_only=True)
class Picture:
    """Scores of a photo's pixels that show the object.

    They are those of the mesh, of the mesh with colours per vertex alone, and of the Gaussians.
    """

    name: str
    pixels: int
    psnr: tuple[float, ...]
    flip: tuple[float | None, ...]


def load_mesh(path: Path, roi: OrientedBox) -> Mesh:
    """A mesh file that `trimesh` reads; of y up or z up, the axes with which it is in the box."""
    trimesh: Any = package("trimesh", "surfaces")
    mesh = trimesh.load(path, force="mesh", process=False)
    vertices = np.asarray(mesh.vertices, dtype=float)
    turned = vertices @ Y_UP.T
    if roi.contains(turned).sum() > roi.contains(vertices).sum():
        vertices = turned
    faces: Ints = np.asarray(mesh.faces, dtype=np.int64)
    uv: Float64 | None = None
    texture: Float64 | None = None
    colours = np.full((len(vertices), 3), 0.5)
    if mesh.visual.kind == "texture" and mesh.visual.uv is not None:
        material = mesh.visual.material
        picture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        if picture is not None:
            texture = np.asarray(picture.convert("RGB"), dtype=float) / 255
            uv = np.asarray(mesh.visual.uv) * (1.0, -1.0) + (0.0, 1.0)
            colours = _looked_up(texture, uv)
    elif mesh.visual.kind in ("vertex", "face"):
        colours = np.asarray(mesh.visual.vertex_colors, dtype=float)[:, :3] / 255
    return Mesh(
        vertices=vertices,
        faces=faces,
        uv=uv,
        texture=texture,
        colours=colours,
        components=_components(vertices, faces),
    )


def _components(vertices: Float64, faces: Ints) -> int:
    """Number of parts that do not touch; vertices at one place, as at a seam, are one."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    _, same = np.unique(vertices.astype(np.float32), axis=0, return_inverse=True)
    used, corners = np.unique(same.reshape(-1)[faces], return_inverse=True)
    a, b, c = corners.reshape(-1, 3).T
    edges = np.concatenate([a, b]), np.concatenate([b, c])
    graph = coo_matrix((np.ones(len(edges[0])), edges), shape=(len(used), len(used)))
    return int(connected_components(graph, directed=False)[0])


def drawn(mesh: Mesh, camera: Camera, world_to_camera: Float64) -> tuple[Float64, Float64]:
    """The mesh's own colours, times alpha (H, W, 3), and its alpha (H, W)."""
    fine = camera.resized(camera.width * FINER, camera.height * FINER)
    pixels, depth, _ = project(mesh.vertices, fine, world_to_camera)
    face, weights = rasterized(pixels, depth, mesh.faces, (fine.height, fine.width))
    shown = face >= 0
    rows = mesh.faces[face[shown]]
    if mesh.texture is None or mesh.uv is None:
        values = (mesh.colours[rows] * weights[shown][..., None]).sum(axis=1)
    else:
        values = _looked_up(mesh.texture, (mesh.uv[rows] * weights[shown][..., None]).sum(axis=1))
    colours = np.zeros((*shown.shape, 4))
    colours[shown] = np.concatenate([values, np.ones((len(values), 1))], axis=1)
    means = colours.reshape(camera.height, FINER, camera.width, FINER, 4).mean(axis=(1, 3))
    return means[..., :3], means[..., 3]


def rasterized(
    pixels: Float64, depth: Float64, faces: Ints, shape: tuple[int, int]
) -> tuple[Ints, Float64]:
    """The face at each pixel's centre, -1 for none, and its corners' weights there.

    Args:
        pixels, depth: (V, 2), (V,) of `project`.
        faces: (F, 3).
        shape: height and width.

    Returns:
        (H, W) and (H, W, 3), which are right in perspective.
    """
    height, width = shape
    near = (depth[faces] > NEAR).all(axis=1)
    low = np.ceil(pixels[faces].min(axis=1) - 0.5).clip(0, None)
    high = np.floor(pixels[faces].max(axis=1) - 0.5).clip(None, (width - 1, height - 1))
    size = (high - low + 1).clip(0, None).astype(np.int64)
    count = np.where(near, size[:, 0] * size[:, 1], 0)
    face = np.repeat(np.arange(len(faces)), count)
    inner = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    x = low[face, 0].astype(np.int64) + inner % size[face, 0]
    y = low[face, 1].astype(np.int64) + inner // size[face, 0]
    corners = pixels[faces[face]]
    at = np.stack([x, y], axis=1) + 0.5
    first, second, third = (corners[:, k] - at for k in range(3))
    weights = np.stack(
        [_crossed(second, third), _crossed(third, first), _crossed(first, second)], axis=1
    )
    area = weights.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = weights / area / depth[faces[face]]
    inside = (weights >= 0).all(axis=1)
    inverse = weights.sum(axis=1)
    order = np.nonzero(inside)[0]
    order = order[np.argsort(inverse[order], kind="stable")]  # the nearest is written last
    shown, mixed = np.full(shape, -1, np.int64), np.zeros((*shape, 3))
    shown[y[order], x[order]] = face[order]
    mixed[y[order], x[order]] = weights[order] / inverse[order, None]
    return shown, mixed


def _crossed(a: Float64, b: Float64) -> Float64:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _looked_up(texture: Float64, uv: Float64) -> Float64:
    """Its colours (N, 3), linearly interpolated."""
    height, width = texture.shape[:2]
    at = np.clip(uv * (width, height) - 0.5, 0, (width - 1.001, height - 1.001))
    left, top = at.astype(np.int64).T
    right, down = (at - np.stack([left, top], axis=1)).T[..., None]
    above = texture[top, left] * (1 - right) + texture[top, left + 1] * right
    below = texture[top + 1, left] * (1 - right) + texture[top + 1, left + 1] * right
    return np.asarray(above * (1 - down) + below * down)


def object_mask(true: Triangles, rest: Triangles, image: PosedImage) -> NDArray[np.bool_]:
    """(H, W) whether a pixel's centre shows the object; `rest` are all other triangles."""
    pose = image.camera, image.world_to_camera
    own, other = (surface_depth(torch.from_numpy(part), *pose) for part in (true, rest))
    return np.asarray((own < other).numpy())


def pictures(
    mesh: Mesh,
    models: tuple[Gaussians, Gaussians],
    images: Iterable[PosedImage],
    surfaces: tuple[Triangles, Triangles],
) -> Iterator[Picture]:
    """Scores of each photo that shows the object large enough.

    Args:
        mesh: in the place of the object.
        models: the whole result, and what is not in the box: it is behind the mesh.
        images: test photos.
        surfaces: true triangles, of the object and of all else: which pixels count.
    """
    whole, rest = models
    for image in images:
        mask = object_mask(*surfaces, image)
        if mask.sum() < LEAST:
            continue
        pose = image.camera, image.world_to_camera
        photo = torch.from_numpy(load_photo(image)).float() / 255
        behind = render_view(rest, *pose).image
        shown = []
        for each in (mesh, replace(mesh, texture=None)):
            colours, alpha = (torch.from_numpy(part).float() for part in drawn(each, *pose))
            shown.append(colours + (1 - alpha[..., None]) * behind)
        shown.append(render_view(whole, *pose).image)
        scores = [_scores(picture, photo, torch.from_numpy(mask)) for picture in shown]
        yield Picture(
            name=image.name,
            pixels=int(mask.sum()),
            psnr=tuple(psnr for psnr, _ in scores),
            flip=tuple(flip for _, flip in scores),
        )


def _scores(picture: Tensor, photo: Tensor, mask: Tensor) -> tuple[float, float | None]:
    psnr = psnr_from_mse(mean_in(squared_error(picture, photo), mask))
    return psnr, flip(picture, photo, mask)
