"""Gaussians that come into a scene without Load Results are in its renders."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.scenes import seen_from_afar

pytestmark = [pytest.mark.blender, pytest.mark.exact_look]

NAME = "thing Gaussians"
WAYS = ["append", "link"]


@pytest.fixture
def brought(blender: ModuleType, run, tmp_path: Path):
    """A function that brings an object of a saved result into a scene of another .blend."""
    bpy, (_, folder) = blender, run
    bpy.ops.roigs.load_results()
    source = tmp_path / "trained.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(source))

    def bring(way: str, name: str = NAME):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        getattr(bpy.ops.wm, way)(directory=f"{source}/Object/", files=[{"name": name}])
        bpy.context.view_layer.update()
        return bpy.context.scene, folder

    return bring


@pytest.mark.parametrize("way", WAYS)
def test_renders_show_them(blender: ModuleType, brought, engine, tmp_path: Path, way: str) -> None:
    scene, _ = brought(way)
    assert seen_from_afar(blender, scene, tmp_path / "f12.png")[..., 3].max() > 0.3


@pytest.mark.parametrize("kind", ["FULL_COPY", "LINK_COPY"])
def test_copied_scenes_show_them(
    blender: ModuleType, run, engine, tmp_path: Path, kind: str
) -> None:
    blender.ops.roigs.load_results()
    blender.ops.scene.new(type=kind)
    scene = blender.context.scene
    assert seen_from_afar(blender, scene, tmp_path / "f12.png")[..., 3].max() > 0.3


@pytest.mark.parametrize("way", WAYS)
def test_the_viewport_draws_them(blender: ModuleType, brought, way: str) -> None:
    from roigs_addon.viewport.objects import marked

    scene, folder = brought(way)
    (found,) = marked(scene.objects)
    assert found.visible and found.file.path == str(folder / "rois" / "thing.ply")


def test_objects_of_another_scene_are_shown_too(blender: ModuleType, run) -> None:
    from roigs_addon.scene import compositor

    blender.ops.roigs.load_results()
    item = blender.data.objects[NAME]
    blender.ops.scene.new(type="EMPTY")
    scene = blender.context.scene
    assert compositor.find(scene) is None
    scene.collection.objects.link(item)
    blender.context.view_layer.update()
    assert compositor.find(scene) is not None and not compositor.lacking(scene)


def test_a_node_that_was_taken_out_stays_out(blender: ModuleType, brought) -> None:
    from roigs_addon.scene import compositor
    from roigs_addon.ui.result import ResultPanel
    from tests.addon.panels import said

    scene, _ = brought("append")
    blender.data.node_groups.remove(compositor.find(scene))
    scene.objects[NAME].copy()
    scene.collection.objects.link(scene.objects[NAME].copy())
    blender.context.view_layer.update()
    assert compositor.find(scene) is None
    assert any("Renders lack the Gaussians" in text for text in said(blender, ResultPanel))
    blender.ops.roigs.show_in_renders()
    assert compositor.find(scene) is not None
    assert not any("Renders lack" in text for text in said(blender, ResultPanel))


@pytest.mark.parametrize("way", WAYS)
def test_without_the_file_they_are_drawn_from_the_blend(
    blender: ModuleType, brought, engine, tmp_path: Path, way: str
) -> None:
    from roigs_addon import rendering

    scene, folder = brought(way)
    (folder / "rois" / "thing.ply").unlink()
    assert seen_from_afar(blender, scene, tmp_path / "f12.png")[..., 3].max() > 0.3
    assert not rendering.problem
