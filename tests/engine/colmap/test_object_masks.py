"""Masks of boxes' objects: found, undistorted, resampled by half, refused, left out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import Context
from roigs_engine.errors import SceneError
from roigs_engine.formats.events import Event, Message
from roigs_engine.model.mask_coverage import (
    counted_pixels,
    object_points,
    object_share,
    with_useful_masks,
)
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import SfmScene
from roigs_engine.photos.mask_images import MaskError, load_mask, load_object_mask
from roigs_engine.photos.mask_paths import MaskOptions
from tests.engine.synthetic_colmap import camera, write_project

NAMES = ("sub/a.png", "b.png", "c.png")
BOX = OrientedBox.between("thing", [-0.5, -0.5, -0.5], [0.5, 0.5, 0.5])
VASE = MaskOptions(boxes=("thing", "other"))


def put(folder: Path, name: str, mask: np.ndarray) -> None:
    path = folder / "masks" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(mask).save(path)


def upper(height: int = 72, width: int = 96, rows: int = 36) -> np.ndarray:
    """A mask that shows the upper rows."""
    mask = np.zeros((height, width), bool)
    mask[:rows] = True
    return mask


def messages(events: list[Event], level: str) -> list[str]:
    return [e.text for e in events if isinstance(e, Message) and e.level == level]


@pytest.mark.parametrize("pixels", [True, False])
def test_masks_of_a_box_are_found_by_the_names_of_photos(tmp_path: Path, pixels: bool) -> None:
    write_project(tmp_path, names=NAMES)
    put(tmp_path, "thing/sub/a.png.png", upper())
    put(tmp_path, "thing/b.png", upper().astype(np.uint16) * 40000)  # 16 bits
    put(tmp_path, "other/c.png.mask.png", upper(rows=20))
    scene = load_colmap(tmp_path, masks=VASE, pixels=pixels)
    for name in NAMES[:2]:
        image = scene.image(name)
        assert image.mask is None and list(image.objects) == ["thing"]
        mask = load_object_mask(image, "thing")
        assert mask is not None and np.array_equal(mask, upper())
    assert list(scene.image("c.png").objects) == ["other"]
    assert load_object_mask(scene.image("c.png"), "thing") is None
    assert not any(image.objects for image in load_colmap(tmp_path).images)
    inverted = MaskOptions(boxes=("thing",), inverted=True)
    mask = load_object_mask(load_colmap(tmp_path, masks=inverted).image("b.png"), "thing")
    assert mask is not None and np.array_equal(mask, upper())  # --invert-masks is for photos


def test_a_photos_own_mask_is_none_of_a_box_with_its_folders_name(tmp_path: Path) -> None:
    write_project(tmp_path, names=("b.png", "thing/b.png"))
    put(tmp_path, "thing/b.png.png", upper())
    scene = load_colmap(tmp_path, masks=VASE, cache=tmp_path / "cache")
    assert scene.image("thing/b.png").mask is not None
    assert not any(image.objects for image in scene.images)


def test_half_a_pixel_shows_the_object(tmp_path: Path) -> None:
    write_project(tmp_path, names=NAMES)
    put(tmp_path, "thing/b.png", upper(rows=37))
    put(tmp_path, "c.png", upper(rows=37))
    scene = load_colmap(tmp_path, masks=VASE, max_side=48)
    shown = load_object_mask(scene.image("b.png"), "thing")
    assert shown is not None and np.array_equal(shown, upper(36, 48, 19))
    counted = load_mask(scene.image("c.png"))
    assert counted is not None and np.array_equal(counted, upper(36, 48, 18))


def test_masks_bend_with_their_photos(tmp_path: Path) -> None:
    lens = camera("SIMPLE_RADIAL", params=[100.0, 48.0, 36.0, 0.3])
    write_project(tmp_path, names=NAMES, cameras=[lens])
    put(tmp_path, "thing/b.png", upper(rows=10))
    image = load_colmap(tmp_path, masks=VASE, cache=tmp_path / "cache").image("b.png")
    mask = load_object_mask(image, "thing")
    assert mask is not None and 0 < len({int(column.sum()) for column in mask.T}) != 1
    path = image.objects["thing"].path
    path.unlink()
    again = load_object_mask(image, "thing")
    assert again is not None and np.array_equal(again, mask)


@pytest.mark.parametrize("kind", ["shape", "empty", "animated", "text"])
def test_wrong_files_are_one_line(tmp_path: Path, kind: str) -> None:
    write_project(tmp_path, names=NAMES)
    put(tmp_path, "thing/b.png", upper(50))
    path = tmp_path / "masks/thing/b.png"
    if kind == "animated":
        frames = [Image.fromarray(upper()), Image.fromarray(~upper())]
        frames[0].save(path, save_all=True, append_images=frames[1:])
    elif kind != "shape":
        path.write_bytes(b"" if kind == "empty" else b"no picture")
    with pytest.raises(MaskError, match=r"thing.b\.png") as caught:
        load_colmap(tmp_path, masks=VASE)
    assert "\n" not in str(caught.value) and "--no-masks" not in str(caught.value)


def test_a_palette_is_read_and_unknown_photos_are_named(tmp_path: Path) -> None:
    write_project(tmp_path, names=NAMES)
    colour = Image.fromarray(np.where(upper(), np.uint8(1), np.uint8(0)), mode="P")
    colour.putpalette([0, 0, 0, 255, 200, 0])
    (tmp_path / "masks/thing").mkdir(parents=True)
    colour.save(tmp_path / "masks/thing/b.png")
    put(tmp_path, "thing/nowhere.png", upper())
    events: list[Event] = []
    scene = load_colmap(tmp_path, masks=VASE, context=Context(emit=events.append))
    mask = load_object_mask(scene.image("b.png"), "thing")
    assert mask is not None and np.array_equal(mask, upper())
    (text,) = [text for text in messages(events, "warning") if "mask of no photo" in text]
    assert "thing/nowhere.png" in text


@pytest.fixture
def scene(tmp_path: Path) -> SfmScene:
    """Masks that show the upper half of a photo, nothing, and a corner beside the box."""
    write_project(tmp_path, names=NAMES)
    put(tmp_path, "thing/sub/a.png", upper())
    put(tmp_path, "thing/b.png", np.zeros((72, 96), bool))
    corner = np.zeros((72, 96), bool)
    corner[:8, :8] = True
    put(tmp_path, "thing/c.png", corner)
    return load_colmap(tmp_path, masks=VASE)


def test_masks_that_show_nothing_in_the_box_are_not_used(scene: SfmScene) -> None:
    events: list[Event] = []
    found = with_useful_masks(scene, [BOX], Context(emit=events.append))
    assert [image.name for image in found.images if image.objects] == ["sub/a.png"]
    assert messages(events, "info") == ["Box 'thing': masks of the object on 1 photo."]
    (text,) = messages(events, "warning")
    assert "2 masks show nothing in the box and are not used: b.png, c.png." in text
    assert not any(image.objects for image in with_useful_masks(scene, []).images)


def test_an_objects_pixels_are_counted(scene: SfmScene) -> None:
    image = scene.image("sub/a.png")
    silhouette = BOX.silhouette(image.camera, image.world_to_camera)
    true = (silhouette & upper()).sum()
    assert counted_pixels(BOX, image) == pytest.approx(true, rel=0.02)
    assert counted_pixels(BOX, image, whole=True) == pytest.approx(silhouette.sum(), rel=0.02)
    assert object_share(BOX, image) == pytest.approx(true / silhouette.sum(), rel=0.02)
    assert object_share(BOX, scene.image("b.png")) == 0


def test_points_that_masks_show_as_something_else_are_not_the_objects(scene: SfmScene) -> None:
    image = scene.image("sub/a.png")
    inside = scene.points[BOX.contains(scene.points)]
    local = inside @ image.world_to_camera[:3, :3].T + image.world_to_camera[:3, 3]
    rows = local[:, 1] / local[:, 2] * image.camera.fy + image.camera.cy
    clear = np.abs(rows - 36) > 1
    found = object_points(inside, BOX, [image])
    assert np.array_equal(found[clear], (rows < 36)[clear]) and 0 < found.sum() < len(found)
    assert object_points(inside, BOX, []).all()


@pytest.mark.parametrize("folder", ["Bu\u0308ste", "b\u00fcste", "BU\u0308STE"])
def test_folders_may_differ_from_their_box_in_case_and_the_form_of_accents(
    tmp_path: Path, folder: str
) -> None:
    write_project(tmp_path, names=NAMES)
    put(tmp_path, f"{folder}/b.png", upper())
    events: list[Event] = []
    options = MaskOptions(boxes=("B\u00fcste",))
    scene = load_colmap(tmp_path, masks=options, context=Context(emit=events.append))
    assert list(scene.image("b.png").objects) == ["B\u00fcste"]
    assert not messages(events, "warning")


def test_two_folders_for_one_box_are_refused(tmp_path: Path) -> None:
    write_project(tmp_path, names=NAMES)
    put(tmp_path, "THING/b.png", upper())
    put(tmp_path, "Thing/b.png", upper())
    if len(list((tmp_path / "masks").iterdir())) == 1:
        pytest.skip("the file system does not tell case")
    with pytest.raises(SceneError, match="2 folders of masks for the box 'thing'"):
        load_colmap(tmp_path, masks=VASE)
    put(tmp_path, "thing/b.png", upper(rows=20))  # the box's very name comes first
    mask = load_object_mask(load_colmap(tmp_path, masks=VASE).image("b.png"), "thing")
    assert mask is not None and np.array_equal(mask, upper(rows=20))


def test_a_folder_of_no_box_is_named_with_the_box_that_it_resembles(tmp_path: Path) -> None:
    write_project(tmp_path, names=NAMES)
    put(tmp_path, "thingy/b.png", upper())
    put(tmp_path, "zzz/b.png", upper())
    put(tmp_path, "sub/a.png.png", upper())  # the mask of a photo
    events: list[Event] = []
    options = replace(VASE, used=False)
    load_colmap(tmp_path, masks=options, context=Context(emit=events.append))
    first, second = messages(events, "warning")
    assert "thingy are not used" in first and first.endswith("Is 'thing' meant?")
    assert "zzz are not used" in second and "meant" not in second
    events.clear()
    options = replace(options, other_boxes=True)
    load_colmap(tmp_path, masks=options, context=Context(emit=events.append))
    assert not messages(events, "warning")
