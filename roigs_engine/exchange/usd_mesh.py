"""Writes a textured mesh as OpenUSD, through the package usd-core."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..formats.others import write_beside
from ..model.scene import Float64
from .usd import pxr_modules, write_stage

MESH, MATERIAL = "/Mesh", "/Mesh/Photos"


def write_mesh(
    path: Path, vertices: Float64, faces: NDArray[np.int64], uv: Float64 | None, picture: bytes
) -> None:
    """Write a mesh with y up; its PNG is inside a .usdz, beside a .usda or .usdc.

    Args:
        path: the suffix selects text, binary or packed.
        vertices, faces: (V, 3), (F, 3).
        uv: (V, 2) places in the texture, from its lower left corner, 0 to 1; None: no texture.
        picture: the PNG.
    """
    geom, vt = pxr_modules("UsdGeom", "Vt")
    packed = path.suffix.lower() == ".usdz"
    texture = "mesh.png" if packed else f"{path.stem}.png"

    def fill(stage: Any, folder: Path) -> None:
        mesh = geom.Mesh.Define(stage, MESH)
        stage.SetDefaultPrim(mesh.GetPrim())
        points = np.ascontiguousarray(vertices, np.float32)
        mesh.GetPointsAttr().Set(vt.Vec3fArray.FromNumpy(points))
        counts = np.full(len(faces), 3, np.int32)
        mesh.GetFaceVertexCountsAttr().Set(vt.IntArray.FromNumpy(counts))
        corners = np.ascontiguousarray(faces.ravel(), np.int32)
        mesh.GetFaceVertexIndicesAttr().Set(vt.IntArray.FromNumpy(corners))
        extent = np.stack([points.min(axis=0), points.max(axis=0)])
        mesh.GetExtentAttr().Set(vt.Vec3fArray.FromNumpy(extent))
        mesh.GetSubdivisionSchemeAttr().Set(geom.Tokens.none)
        if uv is not None:
            _give_texture(stage, mesh, uv, texture)
            (folder / texture).write_bytes(picture)

    if uv is not None and not packed:  # written before the file that names it
        write_beside(path, {texture: picture})
    write_stage(path, "mesh", fill)


def _give_texture(stage: Any, mesh: Any, uv: Float64, texture: str) -> None:
    """Add a rough material in the photos' colours, by the specification of UsdPreviewSurface."""
    geom, shade, sdf, vt = pxr_modules("UsdGeom", "UsdShade", "Sdf", "Vt")
    kinds = sdf.ValueTypeNames
    st = geom.PrimvarsAPI(mesh).CreatePrimvar("st", kinds.TexCoord2fArray, geom.Tokens.vertex)
    st.Set(vt.Vec2fArray.FromNumpy(np.ascontiguousarray(uv, np.float32)))
    material = shade.Material.Define(stage, MATERIAL)

    def shader(name: str, kind: str) -> Any:
        made = shade.Shader.Define(stage, f"{MATERIAL}/{name}")
        made.CreateIdAttr(kind)
        return made

    reader, picture = shader("Reader", "UsdPrimvarReader_float2"), shader("Texture", "UsdUVTexture")
    surface = shader("Surface", "UsdPreviewSurface")
    reader.CreateInput("varname", kinds.String).Set("st")
    places = reader.CreateOutput("result", kinds.Float2)
    picture.CreateInput("file", kinds.Asset).Set(sdf.AssetPath(f"./{texture}"))
    picture.CreateInput("sourceColorSpace", kinds.Token).Set("sRGB")
    picture.CreateInput("st", kinds.Float2).ConnectToSource(places)
    colours = picture.CreateOutput("rgb", kinds.Float3)
    surface.CreateInput("diffuseColor", kinds.Color3f).ConnectToSource(colours)
    surface.CreateInput("roughness", kinds.Float).Set(1.0)
    shown = surface.CreateOutput("surface", kinds.Token)
    material.CreateSurfaceOutput().ConnectToSource(shown)
    shade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
