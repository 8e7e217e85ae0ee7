"""Files of textured meshes: glTF binary, OBJ, PLY, STL."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..formats.files import write_bytes
from ..machine import package
from ..model.local_frame import LocalFrame
from ..model.scene import Float64
from .texture import Textured

PURPOSE = "A mesh's file"
GLB = ".glb"
FILLED = "_filled"  # attribute of vertices in glTF and PLY: 1 where no photo has shown the surface


def write_mesh(
    path: Path, textured: Textured, frame: LocalFrame, up: Float64 | None = None
) -> None:
    """Write a mesh in the world, atomically, in the format that the path ends in.

    Args:
        path: ends in .glb, .obj (with .mtl and .png beside it), .ply or .stl.
        frame: that of the mesh.
        up: (4, 4) rotation that turns the world upright, for glTF; its vertices stay the world's.
    """
    scene = _exported(textured, frame)
    ending = path.suffix.lower()
    if ending == GLB:
        write_bytes(path, _glb(scene, up))
    elif ending == ".obj":
        _write_obj(path, scene)
    else:
        write_bytes(path, scene.export(file_type=ending[1:]))


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


def _glb(mesh: Any, up: Float64 | None) -> bytes:
    trimesh: Any = package("trimesh", PURPOSE)
    scene = trimesh.Scene()
    scene.add_geometry(mesh, node_name="surface", geom_name="surface", transform=up)
    return bytes(trimesh.exchange.gltf.export_glb(scene, include_normals=True))


def _write_obj(path: Path, mesh: Any) -> None:
    """The geometry's file last, so that it never names a texture that is not there."""
    trimesh: Any = package("trimesh", PURPOSE)
    material = mesh.visual.material.to_simple()
    material.name = path.stem
    mesh.visual.material = material
    text, files = trimesh.exchange.obj.export_obj(
        mesh, return_texture=True, mtl_name=f"{path.stem}.mtl", include_normals=True
    )
    for name, content in files.items():
        write_bytes(path.with_name(name), content)
    write_bytes(path, text.encode())
