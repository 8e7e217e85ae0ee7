"""Requests to the engine for a frame of a render."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.levels_cases import FAR, NEAR, make_levels

pytestmark = [pytest.mark.blender, pytest.mark.exact_look]


def test_an_object_that_is_no_camera(blender: ModuleType, run) -> None:
    """Blender lets any object be the scene's camera."""
    from roigs_addon.errors import AddonError
    from roigs_addon.scene.frame_request import frame_request

    scene = run[0]
    blender.ops.roigs.load_results()
    scene.camera = scene.roigs.root
    graph = blender.context.evaluated_depsgraph_get()
    with pytest.raises(AddonError, match="neither perspective nor orthographic"):
        frame_request(scene, graph, "out")


def asked(bpy: ModuleType, scene) -> dict[str, float]:
    """The files of a request, relative to the run folder, and their opacities."""
    from roigs_addon.scene.frame_request import frame_request

    request = frame_request(scene, bpy.context.evaluated_depsgraph_get(), "out")
    assert request is not None
    run = Path(scene.roigs.run_dir)
    return {
        Path(model["ply"]).relative_to(run).as_posix(): model.get("density", 1.0)
        for model in request["models"]
    }


@pytest.fixture
def seen(blender: ModuleType, run):
    """A scene with a result, through a photo's camera, and its run folder."""
    blender.ops.roigs.load_results()
    blender.ops.roigs.look_through(photo="photo 3.png")
    return run


def test_levels_of_detail(blender: ModuleType, seen) -> None:
    scene, folder = seen
    first = {"background.ply": 1.0, "rois/thing.ply": 1.0}
    last = {f"levels/2/{name}": 1.0 for name in first}
    assert asked(blender, scene) == first
    make_levels(folder, rate=NEAR)
    assert asked(blender, scene) == first
    make_levels(folder, rate=FAR)
    assert asked(blender, scene) == last
    scene.roigs.use_levels = False
    assert asked(blender, scene) == first
    scene.roigs.use_levels = True
    scene.objects["Background"].roigs.whole = True
    assert asked(blender, scene) == {"background.ply": 1.0, "levels/2/rois/thing.ply": 1.0}
    (folder / "levels" / "1" / "rois" / "thing.ply").unlink()
    assert asked(blender, scene) == first


def test_the_size_of_the_render_decides_not_its_region(blender: ModuleType, seen) -> None:
    """In 64 times as many pixels, what was drawn with a quarter of the Gaussians is whole."""
    from roigs_addon.scene import cameras

    scene, folder = seen
    render = scene.render
    width, _ = cameras.render_size(render)
    lens = cameras.intrinsics_of(scene.camera.data, render, *cameras.render_size(render))
    make_levels(folder, rate=lens.fx * 5)  # the photos are taken from 2 to 4 units
    whole = asked(blender, scene)
    assert whole.keys() == {"levels/2/background.ply", "levels/2/rois/thing.ply"}
    render.use_border = render.use_crop_to_border = True
    render.border_max_x = render.border_max_y = 0.3
    assert asked(blender, scene) == whole
    render.use_border = False
    render.resolution_x, render.resolution_y = 8 * render.resolution_x, 8 * render.resolution_y
    assert cameras.render_size(render)[0] == 8 * width
    assert asked(blender, scene).keys() == {"background.ply", "rois/thing.ply"}


def test_two_levels_in_a_fade(blender: ModuleType, seen) -> None:
    from roigs_addon.scene import cameras
    from roigs_engine.formats.levels import FADE

    scene, folder = seen
    lens = cameras.intrinsics_of(
        scene.camera.data, scene.render, *cameras.render_size(scene.render)
    )
    found = set()
    for step in range(30):
        rate = lens.fx / 4 * FADE ** (step / 2)
        make_levels(folder, rate=rate, farther=[2.0], parts=["background.ply"])
        models = asked(blender, scene)
        densities = [f for name, f in models.items() if name.endswith("background.ply")]
        assert sum(densities) == pytest.approx(1)
        found.add(len(densities))
    assert found == {1, 2}


def test_exports_are_whole(blender: ModuleType, seen) -> None:
    from roigs_addon.scene.frame_request import models_of, shown

    scene, folder = seen
    make_levels(folder, rate=FAR)
    models = models_of(shown(scene), [], blender.context.evaluated_depsgraph_get())
    assert {Path(m["ply"]).parent.name for m in models} == {"rois", folder.name}
    assert not any("density" in model for model in models)
