"""What the panels draw."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

pytestmark = pytest.mark.blender


def stand_in(cls: type):
    """An object with a panel's methods; without a window Blender makes no panels."""
    methods = {
        name: value
        for c in cls.__mro__
        for name, value in vars(c).items()
        if callable(value) and not name.startswith("__")
    }
    return type("Stand-in", (), methods)()


class Layout:
    """A layout that accepts everything, and keeps the labels, also those of buttons."""

    def __init__(self, labels: list[str]) -> None:
        vars(self)["labels"] = labels

    def __getattr__(self, name: str):
        def take(*args: object, **keywords: object) -> Layout:
            if name in ("label", "operator"):
                self.labels.append(str(keywords.get("text", "")))
            return Layout(self.labels)

        return take

    def __setattr__(self, name: str, value: object) -> None:
        pass


def said(bpy: ModuleType, cls: type) -> list[str]:
    """The labels of a panel."""
    panel = stand_in(cls)
    panel.layout = Layout([])
    panel.draw(bpy.context)
    return panel.layout.labels


def test_missing_files_are_named(blender: ModuleType, run) -> None:
    from roigs_addon.facts import run_facts
    from roigs_addon.ui.result import ResultPanel

    scene, folder = run
    blender.ops.roigs.load_results()
    assert run_facts.missing_splats(scene) == []
    moved = folder.rename(folder.with_name("moved"))
    assert run_facts.missing_splats(scene) == ["Background", "thing Gaussians", "thing coarse"]
    assert any("Missing splat files: Background" in text for text in said(blender, ResultPanel))
    scene.roigs.run_dir = str(moved)
    blender.ops.roigs.load_results()
    assert run_facts.missing_splats(scene) == []


def test_what_renders_lack_is_said(blender: ModuleType, run) -> None:
    from roigs_addon.scene import compositor
    from roigs_addon.ui.result import ResultPanel

    scene, _ = run
    blender.ops.roigs.load_results()
    scene.view_settings.view_transform = "AgX"
    assert any("Colours differ" in text for text in said(blender, ResultPanel))
    scene.view_settings.view_transform = "Standard"
    texts = said(blender, ResultPanel)
    assert not any("Colours differ" in text or "Renders lack" in text for text in texts)
    scene.render.use_compositing = False
    assert any("Switch on" in text for text in said(blender, ResultPanel))
    scene.render.use_compositing = True
    blender.data.node_groups.remove(compositor.find(scene))
    assert any("Renders lack" in text for text in said(blender, ResultPanel))
    blender.ops.roigs.load_results()
    assert compositor.find(scene)
    tree = getattr(scene, "compositing_node_group", None) or scene.node_tree
    (end,) = (node for node in tree.nodes if node.type in compositor.ENDS)
    assert end.inputs[0].links[0].from_node.node_tree == compositor.find(scene)


def test_panels_draw(blender: ModuleType, run) -> None:
    """Every panel's `draw`, on a layout that accepts everything."""
    from roigs_addon.jobs import current
    from roigs_addon.ui import (
        boxes,
        cameras,
        look,
        placement,
        reconstruct,
        result,
        scene,
        train,
    )

    panels = (
        *(reconstruct.PhotosPanel, reconstruct.PhotosOptionsPanel),
        *(placement.PlacementPanel, look.LookPanel),
        *(scene.ScenePanel, boxes.BoxesPanel, boxes.PlacePanel, cameras.CamerasPanel),
        *(train.TrainPanel, train.TrainSettingsPanel, result.ResultPanel),
    )

    def draw_all() -> None:
        for cls in panels:
            if not hasattr(cls, "poll") or cls.poll(blender.context):
                said(blender, cls)

    draw_all()
    blender.ops.roigs.select_cameras()
    blender.ops.roigs.load_results()
    blender.ops.roigs.look_through(photo="photo 0.png")
    draw_all()
    current.state().error = "Something is wrong. " * 9
    draw_all()
    blender.ops.roigs.remove_roi()
    draw_all()


def test_the_look_is_that_of_gaussians(blender: ModuleType, run) -> None:
    from roigs_addon.ui.look import LookPanel

    blender.ops.roigs.load_results()
    for name, shown in (("thing", False), ("Background", True), ("photo 3.png", False)):
        blender.context.view_layer.objects.active = run[0].objects[name]
        assert LookPanel.poll(blender.context) == shown
    blender.context.view_layer.objects.active = run[0].objects["Background"]
    assert said(blender, LookPanel) == ["Background"]
    blender.ops.roigs.show_points(points=True)
    assert not LookPanel.poll(blender.context)


def test_folders_that_cannot_be_looked_at(blender: ModuleType, run, tmp_path: Path) -> None:
    """Such as another user's; here, because their names are too long."""
    from roigs_addon.ui.result import ResultPanel
    from roigs_addon.ui.train import TrainPanel

    scene, strange = run[0], str(tmp_path / ("x" * 300))
    scene.roigs.run_dir = strange
    for panel in (TrainPanel, ResultPanel):
        said(blender, panel)
    assert not blender.ops.roigs.load_results.poll() and not blender.ops.roigs.clean_up.poll()
    with pytest.raises(RuntimeError, match="There is no folder") as failed:
        blender.ops.roigs.import_colmap(directory=strange)
    assert "Traceback" not in str(failed.value)
    with pytest.raises(RuntimeError, match="There is no file") as failed:
        blender.ops.roigs.load_rois(filepath=strange)
    assert "Traceback" not in str(failed.value)
    from roigs_addon.engine import environments

    assert environments.made([Path(strange)]) == []
