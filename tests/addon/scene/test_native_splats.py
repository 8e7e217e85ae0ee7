"""Blender's own splats: what is accepted; nothing remains of what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from numpy.testing import assert_array_equal

from roigs_engine.formats.run_files import BACKGROUND
from tests.addon.scenes import ready
from tests.addon.splat_cases import random_ply

pytestmark = pytest.mark.blender

WHOLE = {
    "position": "FLOAT_VECTOR",
    "scale": "FLOAT_VECTOR",
    "rotation": "QUATERNION",
    "radiance:base": "FLOAT_COLOR",
}


class Newer:
    """A Blender of another version, or with another importer."""

    def __init__(self, bpy: ModuleType, importer: Callable[..., Any] | None) -> None:
        self._bpy = bpy
        self.app = SimpleNamespace(version=(5, 3, 0))
        self.ops = bpy.ops if importer is None else SimpleNamespace(wm=self)
        self.ply_import = importer

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bpy, name)


def makes(bpy: ModuleType, *kinds: dict[str, str] | str) -> Callable[..., set[str]]:
    """An importer that turns and selects what it makes: point clouds with attributes, or meshes."""

    def ply_import(*, filepath: str, **options: Any) -> set[str]:
        assert Path(filepath).is_file()
        assert options["forward_axis"] == "Y" and options["up_axis"] == "Z"
        for item in bpy.context.scene.objects:
            item.select_set(False)
        for kind in kinds:
            if isinstance(kind, str):
                data = bpy.data.meshes.new("import")
            else:
                data = bpy.data.pointclouds.new("import")
                for name in kind.keys() - {a.name for a in data.attributes}:
                    data.attributes.new(name, kind[name], "POINT")
            item = bpy.data.objects.new("import", data)
            item.rotation_euler.x = 1.5
            bpy.context.scene.collection.objects.link(item)
            item.select_set(True)
            bpy.context.view_layer.objects.active = item
        return {"FINISHED"}

    return ply_import


def fails(error: Exception) -> Callable[..., None]:
    def ply_import(**_: Any) -> None:
        raise error

    return ply_import


@pytest.fixture
def scene(blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path):
    for name in ("result", Path(BACKGROUND).stem, "rois/thing", "coarse/thing"):
        path = tmp_path / "run" / f"{name}.ply"
        path.parent.mkdir(parents=True, exist_ok=True)
        random_ply(path, 20, seed=1)
    return ready(blender, project, tmp_path / "run")


def use(monkeypatch: pytest.MonkeyPatch, bpy: ModuleType, importer: Callable[..., Any] | None):

    from roigs_addon.scene import native_splats

    monkeypatch.setattr(native_splats, "bpy", Newer(bpy, importer))


HALVES = {
    "no operator": lambda bpy: fails(AttributeError("ply_import")),
    "other options": lambda bpy: fails(TypeError('keyword "forward_axis" unrecognized')),
    "an error": lambda bpy: fails(RuntimeError("poll() failed, context is incorrect")),
    "nothing": lambda bpy: makes(bpy),
    "a mesh": lambda bpy: makes(bpy, "mesh"),
    "points without radiance": lambda bpy: makes(
        bpy, {name: WHOLE[name] for name in ("position", "scale", "rotation")}
    ),
    "other names": lambda bpy: makes(bpy, {"position": "FLOAT_VECTOR", "radiance": "FLOAT_COLOR"}),
    "two objects": lambda bpy: makes(bpy, WHOLE, WHOLE),
    "this Blender's importer": lambda bpy: None,
}


def test_incomplete_splats_are_refused(
    blender: ModuleType, scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.scene import lookup

    camera = next(iter(lookup.cameras(scene).values()))
    camera.select_set(True)
    blender.context.view_layer.objects.active = camera
    for half, importer in HALVES.items():
        use(monkeypatch, blender, importer(blender))
        assert blender.ops.roigs.load_results() == {"FINISHED"}
        assert [item.type for item in lookup.splats(scene)] == ["MESH"] * 3, half
        blocks = [*blender.data.objects, *blender.data.meshes, *blender.data.pointclouds]
        assert not [block for block in blocks if "import" in block.name], half
        assert len(blender.data.meshes) == 4, half  # with the sparse points
        assert camera.select_get() and blender.context.view_layer.objects.active == camera, half


def test_complete_splats_are_used(
    blender: ModuleType, scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.scene import lookup

    blender.ops.roigs.load_results()
    use(monkeypatch, blender, makes(blender, WHOLE))
    for _ in range(2):  # in place of the add-on's own points, then of its like
        assert blender.ops.roigs.load_results() == {"FINISHED"}
        found = lookup.splats(scene)
        assert {item.roigs.level for item in found} == {"RESULT", "ROI", "SCENE"}
        assert [item.type for item in found] == ["POINTCLOUD"] * 3
        for item in found:
            assert item.parent == scene.roigs.root and item.roigs.as_points
            assert_array_equal(
                item.matrix_basis, [[float(i == j) for j in range(4)] for i in range(4)]
            )
        assert len(blender.data.pointclouds) == 3
    blender.ops.roigs.set_detail(roi="thing", fine=False)
    blender.ops.roigs.show_points(points=False)
    monkeypatch.undo()
    blender.ops.roigs.load_results()
    assert [item.type for item in lookup.splats(scene)] == ["MESH"] * 3


def test_older_blenders_are_not_asked(blender: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:

    from roigs_addon.scene import native_splats

    use(monkeypatch, blender, fails(AssertionError("asked")))
    native_splats.bpy.app.version = (5, 2, 9)
    assert native_splats.import_splats(Path("any.ply")) is None
