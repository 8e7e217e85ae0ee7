"""Pictures by Cycles, within Blender 5.3: `python in_cycles.py JOB.json`; see README.md.

Run by Blender's Python, with the project's folder on its path. The add-on makes the objects and the
cameras. Pictures are NumPy files, (H, W, 3) linear light before black.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np

import roigs_addon
from roigs_addon.geometry.photo import Photo
from roigs_addon.properties import object_props
from roigs_addon.scene import cameras, importing, splats


def scene_of(model: Path) -> Any:
    """A scene with a run's result, an object per box and one for the background, or with a PLY."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene: Any = bpy.context.scene
    if model.is_dir():
        for item in splats.show_results(scene, model):
            item.hide_render = object_props(item).level == "SCENE"
    else:
        splats.show_imported(scene, model, "Model", in_model=False)
    return scene


def set_up(scene: Any, job: dict[str, Any]) -> None:
    """Cycles without denoising, with a box filter of a pixel, before black."""
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.samples = "CYCLES", job["samples"]
    cycles.use_denoising = cycles.use_adaptive_sampling = False
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    render.threads_mode, render.threads = "FIXED", job["threads"]
    render.use_persistent_data = True  # trees of the Gaussians stay
    render.film_transparent = True
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_mode, render.image_settings.color_depth = "RGBA", "32"
    cycles.max_bounces = 0  # splats are lights


def picture(scene: Any, path: Path) -> Any:
    """(H, W, 3) linear light of what the active camera sees, before black."""
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image: Any = bpy.data.images.load(str(path))
    width, height = image.size
    values = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(values)
    bpy.data.images.remove(image)
    path.unlink()
    return values.reshape(height, width, 4)[::-1, :, :3]  # colours are times alpha


def main() -> None:
    """Make the pictures of a job."""
    job = json.loads(Path(sys.argv[-1]).read_text("utf-8"))
    roigs_addon.register()
    scene = scene_of(Path(job["model"]))
    set_up(scene, job)
    size = job["extent"] * importing.CAMERA_SIZE
    views = {}
    for name, record in job["photos"].items():
        views[name] = cameras.new_camera(Photo.from_dict(record), size)
        scene.collection.objects.link(views[name])
    for wanted in job["pictures"]:
        cameras.activate(scene, views[wanted["name"]])
        scene.cycles.seed = wanted["seed"]
        start, path = time.process_time(), Path(wanted["file"])
        found = picture(scene, path.with_suffix(".exr"))
        np.save(path, found)
        print(f"picture {path.name} {time.process_time() - start:.1f} s", flush=True)
    roigs_addon.unregister()


if __name__ == "__main__":
    main()
