"""Creates the GPU programs with their inputs. Their source is in `shaders/`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gpu

from .packing import INDEX_MARK, ROW
from .targets import TYPES

TOGETHER = 32
"""Gaussians per instance: with only one, most of a GPU's lanes would idle."""

Shader = Any
"""A Blender shader. In the stubs, it accepts no matrices."""

FOLDER = Path(__file__).parent / "shaders"


def text(name: str) -> str:
    """Return the text of a GLSL file."""
    return (FOLDER / name).read_text(encoding="utf-8")


def splat_shader(depth: bool) -> Shader:
    """Create the shader for Gaussians: `TOGETHER` quads per instance, corners (-1, -1) to (1, 1).

    Args:
        depth: whether `scene_depth` hides some. On a CPU that emulates a GPU, reading it takes a
            quarter of the time.
    """
    passed = TYPES.GPUStageInterfaceInfo("roigs_splat")
    passed.smooth("VEC2", "local")
    passed.flat("VEC4", "paint")
    info = gpu.types.GPUShaderCreateInfo()
    info.define("ROW", f"{ROW}u")
    info.define("TOGETHER", str(TOGETHER))
    info.define("INDEX_BITS", f"{int(INDEX_MARK) - 1}u")
    info.push_constant("MAT4", "projection")
    info.push_constant("VEC4", "frame")
    info.push_constant("VEC2", "view_size")
    info.push_constant("INT", "sh_texels")
    info.push_constant("INT", "count")
    info.push_constant("BOOL", "linear_light")
    for slot, name in enumerate(("order", "geometry", "colours", "objects")):
        info.sampler(slot, "FLOAT_2D", name)
    if depth:
        info.define("SCENE_DEPTH", "1")
        info.push_constant("VEC2", "pixel")
        info.sampler(4, "FLOAT_2D", "scene_depth")
    info.vertex_in(0, "VEC3", "place")
    info.vertex_out(passed)
    info.fragment_out(0, "VEC4", "colour")
    info.vertex_source(text("splat.vert.glsl"))
    info.fragment_source(text("splat.frag.glsl"))
    return _made(info)


def composite_shader() -> Shader:
    """Create the shader that draws the splats' image over the bound framebuffer, on such a quad."""
    info = gpu.types.GPUShaderCreateInfo()
    info.push_constant("IVEC2", "origin")
    info.push_constant("VEC2", "view_size")
    info.push_constant("BOOL", "linear_target")
    info.push_constant("BOOL", "linear_light")
    info.push_constant("FLOAT", "strength")
    info.sampler(0, "FLOAT_2D", "picture")
    info.sampler(1, "FLOAT_2D", "scene_depth")
    info.vertex_in(0, "VEC2", "corner")
    info.fragment_out(0, "VEC4", "colour")
    info.vertex_source(text("composite.vert.glsl"))
    info.fragment_source(text("composite.frag.glsl"))
    return _made(info)


def point_shader() -> Shader:
    """Create the shader that draws points as discs in their colours, in linear light."""
    passed = TYPES.GPUStageInterfaceInfo("roigs_point")
    passed.flat("VEC3", "paint")
    info = gpu.types.GPUShaderCreateInfo()
    info.push_constant("MAT4", "model_view")
    info.push_constant("MAT4", "projection")
    info.push_constant("VEC3", "sizes")
    info.push_constant("BOOL", "linear_target")
    info.vertex_in(0, "VEC3", "point")
    info.vertex_in(1, "VEC4", "light")
    info.vertex_out(passed)
    info.fragment_out(0, "VEC4", "colour")
    info.vertex_source(text("point.vert.glsl"))
    info.fragment_source(text("point.frag.glsl"))
    return _made(info)


def _made(info: gpu.types.GPUShaderCreateInfo) -> Shader:
    """Create a program, and bind another one.

    Blender compares programs by address. If a new program gets the address of a freed one that was
    bound, Blender would keep drawing with the old one.
    """
    made = gpu.shader.create_from_info(info)
    gpu.shader.from_builtin("UNIFORM_COLOR").bind()
    return made
