"""Pictures of a 3D view: what can be tested of them without a window."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

pytestmark = pytest.mark.blender


@pytest.mark.parametrize("size", [(15360, 8640), (20000, 4), (4, 20000)])
def test_pictures_that_would_end_blender_are_refused(
    blender: ModuleType, addon: ModuleType, size: tuple[int, int]
) -> None:
    from roigs_addon.errors import AddonError
    from roigs_addon.viewport.picture import checked

    with pytest.raises(AddonError, match=f"{size[0]} x {size[1]} pixels is too large"):
        checked(size, 16384)
    assert checked((7680, 4320), 16384) == (7680, 4320)


def test_a_camera_without_a_size_is_named(blender: ModuleType, addon: ModuleType) -> None:
    from roigs_addon.errors import AddonError
    from roigs_addon.viewport.picture import pose

    item = blender.data.objects.new("eye", blender.data.cameras.new("eye"))
    blender.context.collection.objects.link(item)
    for scale, fails in ((0, True), (2, False)):
        item.scale = (scale, scale, scale)
        blender.context.view_layer.update()
        if fails:
            with pytest.raises(AddonError, match="'eye' sees nothing"):
                pose(item)
        else:
            np.testing.assert_allclose(pose(item), np.eye(4), atol=1e-6)


def test_a_saved_picture_keeps_its_file(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    """The next picture is an image of its own: saving it would replace the file of the first."""
    from roigs_addon.operators.viewport_render import _image

    first = _image(np.full((2, 3, 4), 0.25, np.float32))
    assert _image(np.full((4, 4, 4), 0.5, np.float32)) == first and tuple(first.size) == (4, 4)
    first.filepath_raw, first.file_format = str(tmp_path / "one.png"), "PNG"
    first.save()
    second = _image(np.full((2, 2, 4), 1.0, np.float32))
    assert second != first and not second.filepath and tuple(second.size) == (2, 2)
    assert _image(np.ones((2, 2, 4), np.float32)) == second
