"""What the engine is asked to draw for a frame of a render."""

from __future__ import annotations

from types import ModuleType

import pytest

pytestmark = pytest.mark.blender


@pytest.mark.parametrize("kind", ["EMPTY", "ORTHO"])
def test_an_object_that_is_no_perspective_camera(blender: ModuleType, run, kind: str) -> None:
    """Blender lets any object be the scene's camera."""
    from roigs_addon.errors import AddonError
    from roigs_addon.scene.frame_request import frame_request

    scene = run[0]
    blender.ops.roigs.load_results()
    if kind == "EMPTY":
        scene.camera = scene.roigs.root
    else:
        scene.camera = scene.objects["photo 0.png"]
        scene.camera.data.type = kind
    graph = blender.context.evaluated_depsgraph_get()
    with pytest.raises(AddonError, match="not a perspective camera"):
        frame_request(scene, graph, "out")
