"""Scenes as the add-on's user makes them, through its operators."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from types import ModuleType

import numpy as np

from tests.addon.pictures import load_rgba

ROOT = Path(__file__).resolve().parents[2]


def imported(bpy: ModuleType, project: Path):
    """The scene, with a model in it."""
    bpy.ops.roigs.import_colmap(directory=str(project))
    bpy.context.view_layer.update()
    return bpy.context.scene


def add_box(bpy: ModuleType, name: str, low, high):
    """A box between two corners of the COLMAP frame."""
    from mathutils import Vector

    bpy.ops.roigs.add_roi()
    roi = bpy.context.active_object
    low, high = Vector(low), Vector(high)
    roi.name = name
    roi.rotation_mode = "XYZ"
    roi.rotation_euler = 0, 0, 0
    roi.location, roi.scale = (low + high) / 2, (high - low) / 2
    bpy.context.view_layer.update()
    return roi


def ready(bpy: ModuleType, project: Path, run_dir: Path, *, factor: float = 0.004):
    """A scene with a box, settings for a training of seconds, and its run folder."""
    scene = imported(bpy, project)
    add_box(bpy, "thing", (-0.3, -0.3, -0.3), (0.3, 0.3, 0.3))
    scene.roigs.run_dir = str(run_dir)
    scene.roigs.steps_factor = factor
    return scene


def start_training(engine, scene):
    """A job that trains all boxes, as the operator starts it."""
    from roigs_addon.jobs import current, train_job
    from roigs_addon.scene import lookup

    return current.start(engine, train_job.spec(scene, lookup.rois(scene)))


def status(scene):
    """The state of the scene's run folder."""
    from roigs_addon.engine import run_status
    from roigs_addon.jobs import run_folders

    return run_status.read(run_folders.run_folder(scene))


def options(folder: Path, name: str) -> dict:
    """The options file of that name in a run folder, as a job has written it."""
    return json.loads((folder / "blender" / f"{name}.json").read_text(encoding="utf-8"))


def record(roi, scene) -> dict[str, object]:
    """A box as `rois.json` has it."""
    from roigs_addon.scene import lookup

    return lookup.box(roi, scene).record(roi.name).to_dict()


def through_a_photo(bpy: ModuleType, scene):
    """Show a run's results through a photo's camera in Cycles. Returns the render settings."""
    bpy.ops.roigs.load_results()
    bpy.ops.roigs.look_through(photo="photo 3.png")
    render = with_cycles(scene, samples=1)
    render.dither_intensity = 0.0
    return render


def emitting_plane(bpy: ModuleType, camera, size: float, colour: tuple[float, float, float]):
    """A plane in one colour that faces a camera, at the origin; `camera` is the camera's matrix."""
    bpy.ops.mesh.primitive_plane_add(size=size)
    plane = bpy.context.object
    plane.rotation_euler = camera.to_euler()
    material = bpy.data.materials.new("emitting")
    if material.node_tree is None:
        material.use_nodes = True
    material.node_tree.nodes.clear()
    made = material.node_tree.nodes.new
    emission, output = made("ShaderNodeEmission"), made("ShaderNodeOutputMaterial")
    emission.inputs["Color"].default_value = *colour, 1
    material.node_tree.links.new(emission.outputs[0], output.inputs["Surface"])
    plane.data.materials.append(material)
    return plane


def with_cycles(scene, *, samples: int):
    """Have a scene render transparent PNGs with Cycles; skips without it. Returns its settings."""
    import pytest  # not in the Blenders that tests start, which use this file too

    render = scene.render
    try:
        render.engine = "CYCLES"
    except TypeError:
        pytest.skip("this Blender has no Cycles")
    scene.cycles.samples, scene.cycles.device = samples, "CPU"
    scene.cycles.use_denoising = False
    scene.view_settings.view_transform = "Standard"
    render.film_transparent = True
    render.image_settings.file_format = "PNG"
    return render


def seen_from_afar(bpy: ModuleType, scene, out: Path, samples: int = 1) -> np.ndarray:
    """A render of the origin."""
    camera = bpy.data.objects.new("far", bpy.data.cameras.new("far"))
    scene.collection.objects.link(camera)
    camera.location.z, scene.camera = 5.0, camera
    render = with_cycles(scene, samples=samples)
    render.resolution_x = render.resolution_y = 64
    render.filepath = str(out)
    bpy.ops.render.render(write_still=True)
    return load_rgba(out)


def command_line(engine, *arguments: object) -> subprocess.CompletedProcess[str]:
    """The engine as a person starts it, from the same Python and source as the add-on's."""
    return subprocess.run(
        engine.command([str(argument) for argument in arguments]),
        env=engine.environment(),
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )


def drawn_points(bpy: ModuleType) -> dict[str, dict[str, object]]:
    """The points from geometry nodes: object -> number, attributes and first radius."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    found = {}
    for instance in depsgraph.object_instances:
        item = instance.object
        if item.type == "POINTCLOUD":
            data = item.data
            found[item.name] = {
                "points": len(data.points),
                "radius": data.points[0].radius if len(data.points) else 0.0,
                "attributes": set(data.attributes.keys()),
                "type": getattr(data, "type", "POINTS"),
            }
    return found


def listed_stage(run: Path, name: str) -> Path:
    """The folder of a stage of a run's present settings, made and listed as the engine does."""
    from roigs_engine.formats.stage_list import write_stage_list

    folder = run / "stages" / f"{name}-abcdefab"
    folder.mkdir(parents=True, exist_ok=True)
    write_stage_list(run, {name: folder})
    return folder
