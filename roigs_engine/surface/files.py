"""Files of textured meshes: glTF, and from it OBJ, PLY, STL, OpenUSD."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..exchange.arrays import turn
from ..exchange.libraries import NotSupportedError, reading
from ..exchange.page import PageMesh
from ..formats.files import read_bytes, write_bytes
from ..machine import package
from ..model.local_frame import LocalFrame
from ..model.scene import Float64
from .texture import Textured

PURPOSE = "A mesh's file"
USD = (".usda", ".usdc", ".usdz")
UP = {".glb": "y", ".obj": "y", ".ply": "z", ".stl": "z", **dict.fromkeys(USD, "y")}
"""Endings of files, and the axis that points up, as most readers of the format have it."""
FILLED = "_filled"  # attribute of vertices in glTF and PLY: 1 where no photo has shown the surface


def write_mesh(
    path: Path, textured: Textured, frame: LocalFrame, up: Float64 | None = None
) -> None:
    """Write a mesh in the world as a .glb, atomically.

    Args:
        frame: that of the mesh.
        up: (4, 4) rotation that turns the world upright (y up); its vertices stay the world's.
    """
    trimesh: Any = package("trimesh", PURPOSE)
    scene = trimesh.Scene()
    mesh = _exported(textured, frame)
    scene.add_geometry(mesh, node_name="surface", geom_name="surface", transform=up)
    write_bytes(path, bytes(trimesh.exchange.gltf.export_glb(scene, include_normals=True)))


def convert_mesh(source: Path, path: Path, up: str | None = None) -> int:
    """Write the mesh of a .glb in the format that the path ends in, atomically.

    Args:
        source: with y up.
        path: ends as one of `UP`. OBJ and OpenUSD get a PNG beside them, PLY colours of vertices.
        up: the axis that points up in the file; None: as most readers of the format have it.

    Returns:
        The number of faces.

    Raises:
        EngineError: the file cannot be read, or a package is not installed.
    """
    trimesh: Any = package("trimesh", PURPOSE)
    ending = path.suffix.lower()
    with reading(source, "glTF"):
        content = io.BytesIO(read_bytes(source, most=None))
        mesh = trimesh.load(content, file_type="glb", force="mesh", process=False)
        if not len(mesh.faces):
            raise ValueError("no faces")
    mesh.apply_transform(turn("y", up or UP[ending]))
    if ending == ".obj":
        _write_obj(path, mesh)
    elif ending in USD:
        _write_usd(path, mesh)
    else:
        if ending == ".ply" and mesh.visual.kind == "texture":
            mesh.visual = mesh.visual.to_color()
        columns = mesh.vertex_attributes.items()
        mesh.vertex_attributes = {name: values.squeeze() for name, values in columns}
        write_bytes(path, mesh.export(file_type=ending[1:]))
    return len(mesh.faces)


def read_points(path: Path, frame: LocalFrame) -> tuple[Float64, Float64]:
    """(V, 3) points of a surface's .glb in a frame: vertices and middles of faces; their normals.

    Raises:
        EngineError: the file cannot be read, or a package is not installed.
    """
    trimesh: Any = package("trimesh", PURPOSE)
    with reading(path, "glTF"):
        content = io.BytesIO(read_bytes(path, most=None))
        meshes = trimesh.load_scene(content, file_type="glb", process=False).geometry.values()
        points = [np.concatenate([m.vertices, m.triangles_center]) for m in meshes]
        normals = [np.concatenate([m.vertex_normals, m.face_normals]) for m in meshes]
    return frame.points(np.concatenate(points)), np.concatenate(normals)


def sampled_surface(path: Path, count: int) -> tuple[Float64, Float64, Float64]:
    """Places on a surface's .glb that a photo has shown, evenly chosen.

    Args:
        count: how many are tried; what no photo has shown is left out.

    Returns:
        (N, 3) in the world; their normals; the texture's sRGB values there, 0 to 1.

    Raises as `read_points`.
    """
    trimesh: Any = package("trimesh", PURPOSE)
    with reading(path, "glTF"):
        content = io.BytesIO(read_bytes(path, most=None))
        (mesh,) = trimesh.load_scene(content, file_type="glb", process=False).geometry.values()
        picture = np.asarray(mesh.visual.material.baseColorTexture.convert("RGB")) / 255
        columns = mesh.vertices, mesh.vertex_normals, mesh.visual.uv
        values = np.concatenate([np.asarray(column, float) for column in columns], axis=1)
        filled = np.asarray(mesh.vertex_attributes[FILLED]).ravel()
        rng, areas = np.random.default_rng(0), np.asarray(mesh.area_faces)
        corners = np.asarray(mesh.faces)[rng.choice(len(areas), count, p=areas / areas.sum())]
    shares = rng.dirichlet((1.0, 1.0, 1.0), count)
    found = np.einsum("nk,nkd->nd", shares, values[corners])[filled[corners].max(axis=1) == 0]
    side = np.array(picture.shape[1::-1])
    x, y = (found[:, 6:] * (1, -1) * side + (0, side[1])).astype(int).clip(0, side - 1).T
    return found[:, :3], found[:, 3:6], picture[y, x]


def page_meshes(path: Path, matrix: Float64) -> list[PageMesh]:
    """The textured meshes of a surface's .glb for a web page.

    Args:
        matrix: (4, 4) from the world, in which a surface's vertices are, to the page.
    """
    trimesh: Any = package("trimesh", PURPOSE)
    found = []
    with reading(path, "glTF"):
        content = io.BytesIO(read_bytes(path, most=None))
        for mesh in trimesh.load_scene(content, file_type="glb", process=False).geometry.values():
            if mesh.visual.kind != "texture" or mesh.visual.uv is None:
                raise NotSupportedError("a mesh without a texture")
            picture = io.BytesIO()
            mesh.visual.material.baseColorTexture.convert("RGB").save(picture, "JPEG", quality=90)
            vertices = np.asarray(mesh.vertices) @ matrix[:3, :3].T + matrix[:3, 3]
            uv = np.asarray(mesh.visual.uv, dtype=float) * (1.0, -1.0) + (0.0, 1.0)
            faces = np.asarray(mesh.faces)
            found.append(
                PageMesh(vertices=vertices, faces=faces, uv=uv, picture=picture.getvalue())
            )
    return found


def _exported(textured: Textured, frame: LocalFrame) -> Any:
    trimesh: Any = package("trimesh", PURPOSE)
    mesh, charts = textured.mesh, textured.charts
    vertices = mesh.vertices[charts.vertex] / frame.scale + frame.origin
    uv = charts.texels / charts.side
    uv[:, 1] = 1 - uv[:, 1]
    material = trimesh.visual.material.PBRMaterial(
        name="photos",
        baseColorTexture=Image.fromarray(textured.picture),
        metallicFactor=0.0,
        roughnessFactor=1.0,
    )
    filled = np.zeros(len(vertices), np.float32)
    filled[charts.faces[mesh.filled].ravel()] = 1
    return trimesh.Trimesh(
        vertices=vertices,
        faces=charts.faces,
        vertex_normals=mesh.normals()[charts.vertex],
        visual=trimesh.visual.TextureVisuals(uv=uv, material=material),
        vertex_attributes={FILLED: filled},
        process=False,
        validate=False,
    )


def _write_obj(path: Path, mesh: Any) -> None:
    """The geometry's file last, so that it never names a texture that is not there."""
    trimesh: Any = package("trimesh", PURPOSE)
    if mesh.visual.kind == "texture":
        mesh.visual.material = mesh.visual.material.to_simple()
        mesh.visual.material.name = path.stem
    text, files = trimesh.exchange.obj.export_obj(
        mesh, return_texture=True, mtl_name=f"{path.stem}.mtl", include_normals=True
    )
    for name, content in files.items():
        write_bytes(path.with_name(name), content)
    write_bytes(path, text.encode())


def _write_usd(path: Path, mesh: Any) -> None:
    from ..exchange.usd_mesh import write_mesh as write_usd

    uv, picture = None, io.BytesIO()
    if mesh.visual.kind == "texture":
        image = getattr(mesh.visual.material, "baseColorTexture", None)
        if image is not None:
            uv = mesh.visual.uv
            image.save(picture, "PNG")
    write_usd(path, mesh.vertices, mesh.faces, uv, picture.getvalue())
