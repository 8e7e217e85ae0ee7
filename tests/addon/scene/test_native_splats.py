"""Blender's own splats: what is accepted; nothing remains of what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from roigs_engine.formats.run_files import BACKGROUND
from tests.addon.scenes import ready
from tests.addon.splat_cases import random_ply

pytestmark = pytest.mark.blender

C0 = 0.28209479177387814

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
        self.app = SimpleNamespace(version=(5, 3, 0), tempdir=bpy.app.tempdir)
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
        random_ply(path, 20, seed=1, antialiased=name.startswith("rois"))
    made = ready(blender, project, tmp_path / "run")
    blender.ops.roigs.load_results()
    return made


def use(monkeypatch: pytest.MonkeyPatch, bpy: ModuleType, importer: Callable[..., Any] | None):
    from roigs_addon.scene import native_splats

    monkeypatch.setattr(native_splats, "bpy", Newer(bpy, importer))


def reads(bpy: ModuleType, looks: dict[str, Any]) -> Callable[..., set[str]]:
    """An importer that makes splats with the numbers of the PLY, and remembers these."""

    def ply_import(*, filepath: str, **_: Any) -> set[str]:
        from roigs_addon.geometry.splat_cloud import read_splats

        cloud = read_splats(filepath)
        looks["cloud"] = cloud
        data = bpy.data.pointclouds.new("import")
        data.resize(len(cloud))
        columns = {
            "position": cloud.means,
            "scale": cloud.scales,
            "rotation": cloud.quats,
            "radiance:base": np.column_stack((cloud.sh[:, 0], cloud.opacities)),
            **{f"radiance:sh_{k}": cloud.sh[:, k + 1] for k in range(15)},
        }
        for name, values in columns.items():
            kind = WHOLE.get(name, "FLOAT_VECTOR")
            found = data.attributes.get(name) or data.attributes.new(name, kind, "POINT")
            key = {"QUATERNION": "value", "FLOAT_COLOR": "color"}.get(kind, "vector")
            found.data.foreach_set(key, np.ascontiguousarray(values, np.float32).ravel())
        item = bpy.data.objects.new("import", data)
        bpy.context.scene.collection.objects.link(item)
        return {"FINISHED"}

    return ply_import


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
    "an earlier Blender's importer": lambda bpy: None,
}


@pytest.mark.parametrize("half", HALVES)
def test_incomplete_splats_are_refused(
    blender: ModuleType, scene, monkeypatch: pytest.MonkeyPatch, half: str
) -> None:
    from roigs_addon.scene import lookup, native_splats

    if half == "an earlier Blender's importer" and native_splats.exist():
        pytest.skip("this Blender's importer makes splats")
    camera = next(iter(lookup.cameras(scene).values()))
    camera.select_set(True)
    blender.context.view_layer.objects.active = camera
    before = set(blender.data.objects)
    use(monkeypatch, blender, HALVES[half](blender))
    with pytest.raises(RuntimeError, match="importer makes no Gaussian splats"):
        blender.ops.roigs.to_native_splats()
    assert set(blender.data.objects) == before
    assert not any(item.hide_render for item in lookup.splats(scene) if item.roigs.level == "ROI")
    blocks = [*blender.data.meshes, *blender.data.pointclouds]
    assert not [block for block in blocks if "import" in block.name]
    assert camera.select_get() and blender.context.view_layer.objects.active == camera


def test_splats_stand_where_the_gaussians_are(
    blender: ModuleType, scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Moved ones, and those whose origin is at their box; the selected ones are made, alone."""
    from mathutils import Euler, Matrix

    from roigs_addon.scene import lookup

    use(monkeypatch, blender, makes(blender, WHOLE))
    (ours,) = (item for item in lookup.splats(scene) if item.roigs.level == "ROI")
    ours.matrix_world = Matrix.LocRotScale((1, 2, 3), Euler((0.3, 0.2, 0.1)), (2, 2, 2))
    ours.select_set(True)
    blender.context.view_layer.update()
    assert blender.ops.roigs.to_native_splats() == {"FINISHED"}
    (made,) = (item for item in scene.objects if item.type == "POINTCLOUD")
    blender.context.view_layer.update()
    assert made.name == f"{ours.name} Splats" and made not in lookup.splats(scene)
    frame = np.array(ours.data["roigs_frame"]).reshape(4, 4)
    assert_allclose(made.matrix_world, np.array(ours.matrix_world) @ frame, atol=1e-5)
    assert ours.hide_viewport and ours.hide_render
    assert made.select_get() and not ours.select_get()
    assert blender.context.view_layer.objects.active == made
    assert set(made.users_collection) == set(ours.users_collection)


def test_the_way_there_and_back_changes_nothing(
    blender: ModuleType, scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But that deleted points stay deleted, and a changed look is in the colours."""
    from roigs_addon.scene import lookup
    from roigs_addon.scene.splat_attributes import cloud_of

    if "resize" not in blender.types.PointCloud.bl_rna.functions:
        pytest.skip("Python cannot resize this Blender's point clouds")
    looks: dict[str, Any] = {}
    use(monkeypatch, blender, reads(blender, looks))
    (ours,) = (item for item in lookup.splats(scene) if item.roigs.level == "ROI")
    cloud, _ = cloud_of(ours.data)
    ours.roigs.exposure = 1.0
    ours.select_set(True)
    assert blender.ops.roigs.to_native_splats() == {"FINISHED"}
    written = looks["cloud"]
    assert_allclose(0.5 + C0 * written.sh[:, 0], 2 * (0.5 + C0 * cloud.sh[:, 0]), atol=1e-5)
    assert_allclose(written.sh[:, 1:], 2 * cloud.sh[:, 1:], atol=1e-5)
    (made,) = (item for item in scene.objects if item.type == "POINTCLOUD")
    blender.context.view_layer.objects.active = made
    assert blender.ops.roigs.from_native_splats() == {"FINISHED"}
    back = blender.context.view_layer.objects.active
    blender.context.view_layer.update()
    assert back in lookup.splats(scene) and back.roigs.level == "IMPORTED"
    assert_allclose(back.matrix_world, made.matrix_world, atol=1e-6)
    again, _ = cloud_of(back.data)
    for name in ("means", "scales", "opacities", "sh"):
        assert_allclose(getattr(again, name), getattr(written, name), atol=1e-5)
    assert cloud.antialiased and written.antialiased and again.antialiased
    assert made.hide_render and Path(back.roigs.ply).is_file()


def test_every_object_that_was_made_is_selected(
    blender: ModuleType, scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And nothing else; the active one is that of the active object, and not a hidden one."""
    from roigs_addon.scene import lookup

    use(monkeypatch, blender, makes(blender, WHOLE))
    objects = blender.context.view_layer.objects
    background = next(i for i in lookup.splats(scene) if i.roigs.level == "RESULT")
    objects.active = background
    assert blender.ops.roigs.to_native_splats() == {"FINISHED"}
    made = [item for item in scene.objects if item.type == "POINTCLOUD"]
    assert len(made) == 2 and set(objects.selected) == set(made)
    assert objects.active.name == f"{background.name} Splats"


def test_blenders_own_importer_changes_nothing(blender: ModuleType, scene) -> None:
    """There and back through the importer of this Blender."""
    from roigs_addon.scene import lookup, native_splats
    from roigs_addon.scene.splat_attributes import cloud_of

    if not native_splats.exist():
        pytest.skip("this Blender has no splats of its own")
    (ours,) = (item for item in lookup.splats(scene) if item.roigs.level == "ROI")
    ours.select_set(True)
    before, _ = cloud_of(ours.data)
    assert blender.ops.roigs.to_native_splats() == {"FINISHED"}
    made = blender.context.view_layer.objects.active
    assert made.type == "POINTCLOUD" and made.data.type == "GAUSSIAN_SPLAT"
    assert blender.ops.roigs.from_native_splats() == {"FINISHED"}
    again, _ = cloud_of(blender.context.view_layer.objects.active.data)
    for name in ("means", "sh", "scales", "opacities", "quats"):
        assert_allclose(getattr(again, name), getattr(before, name), rtol=2e-6, atol=1e-6)
    assert np.array_equal(again.sh, before.sh)
    assert again.target == before.target


def test_four_numbers_of_a_newer_blender_are_read(blender: ModuleType, addon) -> None:
    """Blender 5.3 keeps `radiance:base` as a type of attribute that earlier ones do not have."""
    from roigs_addon.scene.splat_attributes import values

    numbers = np.arange(8, dtype=np.float32)

    def foreach_get(name: str, into: np.ndarray) -> None:
        assert name == "vector"
        into[:] = numbers

    column = SimpleNamespace(foreach_get=foreach_get)
    attribute = SimpleNamespace(domain="POINT", data_type="FLOAT4", data=column)
    points = SimpleNamespace(points=[0, 1], attributes={"radiance:base": attribute})
    assert np.array_equal(values(points, "radiance:base"), numbers.reshape(2, 4))


def test_older_blenders_say_why(blender: ModuleType, scene, monkeypatch) -> None:
    """Results are the add-on's own points in every Blender: only they can be cleaned up."""
    from roigs_addon.scene import lookup, native_splats

    use(monkeypatch, blender, fails(AssertionError("asked")))
    blender.ops.roigs.load_results()
    assert [item.type for item in lookup.splats(scene)] == ["MESH"] * 3
    native_splats.bpy.app.version = (5, 2, 9)
    assert not native_splats.exist()
    with pytest.raises(RuntimeError, match=r"from version 5\.3 on"):
        blender.ops.roigs.to_native_splats()
    with pytest.raises(RuntimeError, match="Select an object of Blender's own splats"):
        blender.ops.roigs.from_native_splats()
