"""Groups of nodes of a stranger's .blend that have the names of ours are not taken for ours."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

pytestmark = pytest.mark.blender


def of_another_type(bpy: ModuleType, group: Any) -> None:
    name, group.name = group.name, "away"
    bpy.data.node_groups.new(name, "CompositorNodeTree").use_fake_user = True


def without_inputs(bpy: ModuleType, group: Any) -> None:
    group.interface.clear()


def with_other_inputs(bpy: ModuleType, group: Any) -> None:
    for item in list(group.interface.items_tree):
        if item.in_out == "INPUT":
            item.socket_type = "NodeSocketFloat"


def with_one_more(bpy: ModuleType, group: Any) -> None:
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketFloat")


def with_a_panel(bpy: ModuleType, group: Any) -> None:
    group.interface.new_panel("Exposure")


CHANGES = (of_another_type, without_inputs, with_other_inputs, with_one_more, with_a_panel)


@pytest.mark.parametrize("change", CHANGES)
def test_splats_are_shown_by_our_own_group(
    blender: ModuleType, run, change: Callable[[ModuleType, Any], None]
) -> None:
    """From Blender 5.3 on; before, by the group without any geometry."""
    from roigs_addon.scene import display, native_splats

    blender.ops.roigs.load_results()
    name = display.SPLATS if native_splats.exist() else display.NOTHING
    change(blender, blender.data.node_groups[name])
    for _ in range(2):
        for way in ("POINTS", "GAUSSIANS"):
            assert blender.ops.roigs.show_as(way=way) == {"FINISHED"}
        blender.context.view_layer.update()
    (used,) = {
        item.modifiers[display.MODIFIER].node_group
        for item in blender.data.objects
        if item.roigs.kind == "SPLATS"
    }
    assert used.name.startswith(name) and used.bl_idname == display.TREE
    assert len([g for g in blender.data.node_groups if g.name.startswith(name)]) <= 2


@pytest.mark.parametrize("change", CHANGES)
def test_captured_surfaces_have_our_own_group(
    blender: ModuleType, addon, change: Callable[[ModuleType, Any], None]
) -> None:
    from roigs_addon.scene import proxies

    first = proxies._group()
    change(blender, first)
    ours = proxies._group()
    assert (ours == first) == (change is of_another_type and ours.name == "away")
    assert "Distance" in [item.name for item in ours.interface.items_tree]
    assert ours.bl_idname == "ShaderNodeTree" and proxies._group() == ours
