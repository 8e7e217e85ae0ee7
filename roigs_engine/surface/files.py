"""Files of textured meshes: glTF, and its conversion to OBJ, PLY, STL, OpenUSD."""

from __future__ import annotations

import functools
import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..context import QUIET, Context
from ..exchange.arrays import turn
from ..exchange.gltf import has_triangles
from ..exchange.gltf_file import GltfFile, shown
from ..exchange.libraries import NotSupportedError, reading
from ..exchange.page import PageMesh
from ..formats.files import write_bytes
from ..formats.others import write_beside
from ..machine import package
from ..model.local_frame import LocalFrame
from ..model.scene import Float64
from ..photos.headers import open_picture
from .texture import Textured

PURPOSE = "A mesh's file"
USD = (".usda", ".usdc", ".usdz")
UP = {".glb": "y", ".obj": "y", ".ply": "z", ".stl": "z", **dict.fromkeys(USD, "y")}
"""Suffix of a file -> the up axis of most readers of the format."""
FILLED = "_filled"  # attribute of vertices in glTF and PLY: 1 where no photo has shown the surface
POINTS = 200_000  # points on a surface; they are closer than the voxels of any mesh beside it


def write_mesh(
    path: Path, textured: Textured, frame: LocalFrame, up: Float64 | None = None
) -> None:
    """Write a mesh in the world as a .glb, atomically.

    Args:
        frame: the mesh's frame.
        up: (4, 4) rotation that turns the world upright (y up); its vertices stay the world's.
    """
    trimesh: Any = package("trimesh", PURPOSE)
    scene = trimesh.Scene()
    mesh = _exported(textured, frame)
    scene.add_geometry(mesh, node_name="surface", geom_name="surface", transform=up)
    write_bytes(path, bytes(trimesh.exchange.gltf.export_glb(scene, include_normals=True)))


def convert_mesh(source: Path, path: Path, up: str | None = None, context: Context = QUIET) -> int:
    """Write the mesh of a .glb in the format that the path ends in, atomically.

    Args:
        source: a .glb with y up.
        path: has a suffix of `UP`. OBJ and OpenUSD get a PNG beside them, PLY colours of vertices.
        up: the up axis of the file; None: that of most readers of the format.

    Returns:
        The number of faces.

    Raises:
        EngineError: the file cannot be read, or a package is not installed.
        Stopped: on request, while the file is read.
    """
    trimesh: Any = package("trimesh", PURPOSE)
    ending = path.suffix.lower()
    with reading(source, "glTF"):
        placed = _read(source, context)
        for matrix, part in placed:
            part.apply_transform(matrix)
        mesh = trimesh.util.concatenate([part for _, part in placed])
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


def read_points(path: Path, frame: LocalFrame, context: Context = QUIET) -> tuple[Float64, Float64]:
    """(N, 3) points all over a surface's .glb, in a frame, and their normals.

    Raises as `convert_mesh`.
    """
    with reading(path, "glTF"):
        meshes = [mesh for _, mesh in _read(path, context, textured=False)]
        corners = np.concatenate([np.asarray(mesh.triangles) for mesh in meshes])
        normals = np.concatenate([np.asarray(mesh.face_normals) for mesh in meshes])
        areas = np.concatenate([np.asarray(mesh.area_faces) for mesh in meshes])
        faces, shares = _spread(areas, POINTS)
    return frame.points(np.einsum("nk,nkd->nd", shares, corners[faces])), normals[faces]


def sampled_surface(
    path: Path, count: int, context: Context = QUIET
) -> tuple[Float64, Float64, Float64]:
    """Places on a surface's .glb that a photo has shown, evenly chosen.

    Args:
        count: number of places to try; those that no photo has shown are left out.

    Returns:
        (N, 3) in the world; their normals; the texture's sRGB values there, 0 to 1.

    Raises as `convert_mesh`.
    """
    with reading(path, "glTF"):
        ((_, mesh),) = _read(path, context)
        picture = np.asarray(mesh.visual.material.baseColorTexture.convert("RGB"))
        columns = mesh.vertices, mesh.vertex_normals, mesh.visual.uv
        values = np.concatenate([np.asarray(column, float) for column in columns], axis=1)
        filled = np.asarray(mesh.vertex_attributes[FILLED]).ravel()
        faces, shares = _spread(np.asarray(mesh.area_faces), count)
        corners = np.asarray(mesh.faces)[faces]
    found = np.einsum("nk,nkd->nd", shares, values[corners])[filled[corners].max(axis=1) == 0]
    side = np.array(picture.shape[1::-1])
    x, y = (found[:, 6:] * (1, -1) * side + (0, side[1])).astype(int).clip(0, side - 1).T
    return found[:, :3], found[:, 3:6], picture[y, x] / 255


def _spread(areas: Float64, count: int) -> tuple[NDArray[np.int64], Float64]:
    """Return places all over a mesh: their faces (count,), and shares (count, 3) of the corners.

    ValueError if the mesh has no area.
    """
    rng = np.random.default_rng(0)
    faces = rng.choice(len(areas), count, p=areas / areas.sum())
    return faces, rng.dirichlet((1.0, 1.0, 1.0), count)


def page_meshes(path: Path, matrix: Float64, context: Context = QUIET) -> list[PageMesh]:
    """The textured meshes of a surface's .glb for a web page.

    Args:
        matrix: (4, 4) from the world, in which a surface's vertices are, to the page.

    Raises as `convert_mesh`.
    """
    found, pictures = [], dict[int, bytes]()  # many meshes may show the same picture
    with reading(path, "glTF"):
        for _, mesh in _read(path, context):
            if mesh.visual.kind != "texture":
                raise NotSupportedError("a mesh without a texture")
            texture = mesh.visual.material.baseColorTexture
            if id(texture) not in pictures:
                out = io.BytesIO()
                texture.convert("RGB").save(out, "JPEG", quality=90)
                pictures[id(texture)] = out.getvalue()
            picture = pictures[id(texture)]
            vertices = np.asarray(mesh.vertices) @ matrix[:3, :3].T + matrix[:3, 3]
            uv = np.asarray(mesh.visual.uv, dtype=float) * (1.0, -1.0) + (0.0, 1.0)
            faces = np.asarray(mesh.faces)
            found.append(PageMesh(vertices=vertices, faces=faces, uv=uv, picture=picture))
    return found


def _read(path: Path, context: Context, *, textured: bool = True) -> list[tuple[Float64, Any]]:
    """The meshes of a .glb, each with the matrix (4, 4) that places it; at least one.

    Read by our own reader, as trimesh's opens pictures of any format, some of which are programs,
    and takes any count that the file names. `textured`: the textures too, decoded.
    """
    return context.interruptible(lambda: _meshes(path, textured=textured))


@np.errstate(all="ignore")  # a thread has its own
def _meshes(path: Path, *, textured: bool) -> list[tuple[Float64, Any]]:
    trimesh: Any = package("trimesh", PURPOSE)
    file = GltfFile(path)
    placed = shown(file.record, has_triangles)
    faces = [file.rows(int(item["indices"])) for _, item in placed]
    if not faces:
        raise ValueError("no faces")
    found, materials = [], dict[int, Any]()
    for (matrix, item), corners in zip(placed, faces, strict=True):
        at = item["attributes"]
        wanted = {"POSITION": 3, "NORMAL": 3, "TEXCOORD_0": 2, FILLED: 1}
        columns = {name: file.values(int(at[name])) for name in wanted if name in at}
        for name, values in columns.items():
            if values.shape != (len(columns["POSITION"]), wanted[name]):
                raise ValueError(f"{name} does not fit the vertices")
            if not np.isfinite(values).all():
                raise ValueError(f"{name} has numbers that are not finite")
        if corners.dtype.kind == "f" or corners.size % 3:
            raise ValueError("faces of vertices that it does not have")
        if corners.min() < 0 or corners.max() >= len(columns["POSITION"]):
            raise ValueError("faces of vertices that it does not have")
        at_place = columns["POSITION"] @ matrix[:3, :3].T + matrix[:3, 3]
        if not all(np.isfinite(a.astype(np.float32)).all() for a in (matrix, at_place)):
            raise ValueError("its nodes place vertices infinitely far away")
        filled = {FILLED: columns[FILLED][:, 0]} if FILLED in columns else {}
        mesh = trimesh.Trimesh(
            vertices=columns["POSITION"],
            faces=corners.reshape(-1, 3).astype(np.int64),
            vertex_normals=columns.get("NORMAL"),
            visual=_texture(file, item, columns.get("TEXCOORD_0"), materials) if textured else None,
            vertex_attributes=filled,
            process=False,
            validate=False,
        )
        found.append((matrix, mesh))
    return found


def _texture(file: GltfFile, item: dict[str, Any], uv: Any, materials: dict[int, Any]) -> Any:
    """Return a primitive's texture in trimesh's form, or None if it has none.

    `materials`: number of a picture -> its material, for the file's pictures so far.
    """
    trimesh: Any = package("trimesh", PURPOSE)
    if uv is None or "material" not in item:
        return None
    record = file.record
    about = record["materials"][item["material"]].get("pbrMetallicRoughness", {})
    if "baseColorTexture" not in about:
        return None
    texture = record["textures"][about["baseColorTexture"]["index"]]
    material = materials.get(texture["source"])
    if material is None:  # many primitives may show the same picture
        content = bytes(file.view(record["images"][texture["source"]]["bufferView"]))
        picture = open_picture(content, ("PNG", "JPEG"))
        file.count(3 * picture.width * picture.height)
        picture.load()
        material = materials[texture["source"]] = _material(picture)
    return trimesh.visual.TextureVisuals(uv=uv * (1, -1) + (0, 1), material=material)


def _material(picture: Image.Image) -> Any:
    trimesh: Any = package("trimesh", PURPOSE)
    kind: Any = trimesh.visual.material.PBRMaterial

    class Material(kind):  # type: ignore[misc]
        """A material that is hashed once; trimesh's hashes all pixels for each mesh with it."""

        @functools.cached_property
        def known(self) -> int:
            return int(super().__hash__())

        def __hash__(self) -> int:
            return self.known

    return Material(
        name="photos", baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=1.0
    )


def _exported(textured: Textured, frame: LocalFrame) -> Any:
    trimesh: Any = package("trimesh", PURPOSE)
    mesh, charts = textured.mesh, textured.charts
    vertices = mesh.vertices[charts.vertex] / frame.scale + frame.origin
    uv = charts.texels / charts.side
    uv[:, 1] = 1 - uv[:, 1]
    filled = np.zeros(len(vertices), np.float32)
    filled[charts.faces[mesh.filled].ravel()] = 1
    return trimesh.Trimesh(
        vertices=vertices,
        faces=charts.faces,
        vertex_normals=mesh.normals()[charts.vertex],
        visual=trimesh.visual.TextureVisuals(
            uv=uv, material=_material(Image.fromarray(textured.picture))
        ),
        vertex_attributes={FILLED: filled},
        process=False,
        validate=False,
    )


def _write_obj(path: Path, mesh: Any) -> None:
    """Write an OBJ, its geometry last, so that this never names a missing texture."""
    trimesh: Any = package("trimesh", PURPOSE)
    if mesh.visual.kind == "texture":
        mesh.visual.material = mesh.visual.material.to_simple()
        mesh.visual.material.name = path.stem
    text, files = trimesh.exchange.obj.export_obj(
        mesh, return_texture=True, mtl_name=f"{path.stem}.mtl", include_normals=True
    )
    write_beside(path, files)
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
