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
    np.testing.assert_allclose(first.pixels[:4], 0.5, atol=0.5 / 255)
    kept = str(tmp_path / "one.png")
    first.filepath_raw, first.file_format = kept, "PNG"
    first.save()
    second = _image(np.full((2, 2, 4), 1.0, np.float32))
    assert second != first and second.filepath != kept and tuple(second.size) == (2, 2)
    assert _image(np.ones((2, 2, 4), np.float32)) == second
    second.pack()
    assert _image(np.ones((3, 3, 4), np.float32)) != second


def test_a_picture_is_no_change_that_blender_asks_to_save(
    blender: ModuleType, addon: ModuleType
) -> None:
    """At each saving of the .blend, that is; also after a second one, of another size."""
    from roigs_addon.operators.viewport_render import _image

    for side in (2, 3):
        image = _image(np.full((side, side, 4), 0.25, np.float32))
        assert not image.is_dirty and image.name == "Viewport Render with Gaussians"
        assert not any(other.is_dirty for other in blender.data.images)
