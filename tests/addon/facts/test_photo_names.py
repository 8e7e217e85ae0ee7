"""Names of photos in the panel."""

from __future__ import annotations

from types import ModuleType

import pytest

pytestmark = pytest.mark.blender


def test_photos_are_shown_without_folders_where_that_is_clear(
    blender: ModuleType, addon: ModuleType
) -> None:
    from roigs_addon.facts.photo_names import shortened

    names = ["a/1.jpg", "b/1.jpg", "b/deep/2.png", "3.jpg"]
    assert list(shortened(names).values()) == ["a/1", "b/1", "2", "3"]


@pytest.mark.parametrize(
    ("names", "short"),
    [
        (["P81019-151234.jpg", "P81019-151250.jpg"], ["151234", "151250"]),
        (["IMG_0001.JPG", "IMG_0002.JPG"], ["IMG_0001", "IMG_0002"]),
        (
            ["rig/left/frame_01.png", "rig/right/frame_01.png", "rig/left/frame_02.png"],
            ["left/frame_01", "right/frame_01", "frame_02"],
        ),
        (
            [f"rig/{side}/frame_0{n}.png" for side in ("left", "right") for n in (1, 2)],
            ["left/01", "left/02", "right/01", "right/02"],
        ),
        (["a/1.jpg", "a/1.png"], ["a/1.jpg", "a/1.png"]),
        (["20181019151234.jpg", "20181019151250.jpg"], ["…1234", "…1250"]),
        (["shot_0001_undistorted.png", "shot_0022_undistorted.png"], ["0001", "0022"]),
        (["cover.jpg", "P81019-151234.jpg", "P81019-151250.jpg"], ["cover", "151234", "151250"]),
        (
            ["another long name.jpg", "P81019-151234.jpg", "P81019-151250.jpg"],
            ["… long name", "…019-151234", "…019-151250"],
        ),
        (["only one long name.jpg"], ["only one long name"]),
        (["a long beginning", "a long beginning 2"], ["…ng", "…ng 2"]),
    ],
)
def test_long_names_are_cut_to_what_differs(
    blender: ModuleType, addon: ModuleType, names: list[str], short: list[str]
) -> None:
    from roigs_addon.facts.photo_names import shortened

    assert list(shortened(names).values()) == short
