"""The masks of a scene's photos: distorted cameras, all sizes, alpha channels, wrong files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.colmap.camera_masks import HIDDEN
from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import Context
from roigs_engine.errors import SceneError
from roigs_engine.formats.events import Event, Message
from roigs_engine.photos.decode import load_photo
from roigs_engine.photos.mask_images import MaskError, load_mask
from roigs_engine.photos.mask_paths import MaskOptions
from tests.engine.colmap.distorted import distorted
from tests.engine.synthetic_colmap import camera, write_project

NAMES = ("sub/a.png", "b.png", "c.png")


def put(folder: Path, name: str, mask: np.ndarray) -> None:
    path = folder / "masks" / f"{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(mask).save(path)


def left(width: int = 96, height: int = 72) -> np.ndarray:
    """A mask that ignores the left third."""
    mask = np.ones((height, width), bool)
    mask[:, : width // 3] = False
    return mask


def warnings(events: list[Event]) -> list[str]:
    return [e.text for e in events if isinstance(e, Message) and e.level == "warning"]


def test_masks_beside_the_photos_are_used(tmp_path: Path) -> None:
    write_project(tmp_path, names=NAMES)
    put(tmp_path, "sub/a.png", left())
    put(tmp_path, "c.png", np.ones((72, 96), bool))  # ignores nothing
    scene = load_colmap(tmp_path, cache=tmp_path / "cache")
    masks = {image.name: load_mask(image) for image in scene.images}
    assert masks["b.png"] is None and masks["c.png"] is None
    assert np.array_equal(masks["sub/a.png"], left())
    half = load_colmap(tmp_path, max_side=48).image("sub/a.png")
    assert np.array_equal(load_mask(half), left(48, 36))
    assert np.array_equal(load_mask(scene.image("sub/a.png").scaled(0.5)), left(48, 36))
    assert load_colmap(tmp_path, masks=MaskOptions(used=False)).image("sub/a.png").mask is None
    inverted = load_colmap(tmp_path, masks=MaskOptions(inverted=True))
    assert np.array_equal(load_mask(inverted.image("sub/a.png")), ~left())
    assert dict(inverted.skipped) == {HIDDEN: ("c.png",)}


def test_cameras_alone_have_the_same_masks_once_these_are_known(tmp_path: Path) -> None:
    write_project(tmp_path, names=NAMES)
    put(tmp_path, "b.png", left())
    cache = tmp_path / "cache"
    before = load_colmap(tmp_path, cache=cache, pixels=False).image("b.png").mask
    assert before is not None and not cache.exists()
    assert load_colmap(tmp_path, pixels=False).image("b.png").mask is None
    full = load_colmap(tmp_path, cache=cache).image("b.png").mask
    again = load_colmap(tmp_path, cache=cache, pixels=False).image("b.png").mask
    assert full is not None and again is not None
    assert before.digest == full.digest == again.digest
    put(tmp_path, "b.png", ~left())
    other = load_colmap(tmp_path, cache=cache, pixels=False).image("b.png").mask
    assert other is not None and other.digest != full.digest


def test_a_mask_is_undistorted_with_its_photo(tmp_path: Path) -> None:
    """A photo that is dark where its mask is black: both bend alike."""
    distorted(tmp_path, "OPENCV")
    y, x = np.mgrid[:180, :240]
    mask = (x // 40 + y // 45) % 2 == 0
    Image.fromarray(np.where(mask, np.uint8(255), np.uint8(0))).convert("RGB").save(
        tmp_path / "images/a.png"
    )
    put(tmp_path, "a.png", mask)
    (image,) = load_colmap(tmp_path, cache=tmp_path / "cache").images
    found, photo = load_mask(image), load_photo(image)[..., 0]
    assert found is not None
    assert (photo[found] > 250).all()  # nothing of the dark parts
    assert (photo[~found] > 250).mean() < 0.05  # and hardly more is ignored than they


@pytest.mark.parametrize("side", [None, 150])
def test_ignored_pixels_leave_no_colour_in_undistorted_photos(
    tmp_path: Path, side: int | None
) -> None:
    """They do in the interpolation, and in resampling, of a photo without its mask."""
    distorted(tmp_path, "OPENCV")
    mask = np.kron(np.random.default_rng(0).random((18, 24)) > 0.1, np.ones((10, 10), bool))
    Image.fromarray(np.where(mask, np.uint8(128), np.uint8(0))).save(tmp_path / "images/a.png")

    def loaded() -> np.ndarray:
        scene = load_colmap(tmp_path, cache=tmp_path / "cache", max_side=side)
        return load_photo(scene.image("a.png"))[..., 0].astype(int)

    without = loaded()
    put(tmp_path, "a.png", mask)
    image = load_colmap(tmp_path, cache=tmp_path / "cache", max_side=side).image("a.png")
    found = load_mask(image)
    assert found is not None and found.mean() > 0.5
    assert np.abs(without[found] - 128).max() > 5
    assert np.abs(loaded()[found] - 128).max() <= 1
    image.path.unlink()
    assert np.abs(loaded()[found] - 128).max() <= 1  # made again in the same way


def test_an_alpha_channel_is_a_mask_unless_a_file_is(tmp_path: Path) -> None:
    write_project(tmp_path, names=NAMES)
    for name, alpha in (("b.png", left()), ("c.png", np.ones((72, 96), bool))):
        path = tmp_path / "images" / name
        photo = Image.open(path).convert("RGB")
        photo.putalpha(Image.fromarray(alpha).convert("L"))
        photo.save(path)
    scene = load_colmap(tmp_path)
    assert np.array_equal(load_mask(scene.image("b.png")), left())
    assert scene.image("c.png").mask is None  # opaque
    put(tmp_path, "b.png", ~left())
    assert np.array_equal(load_mask(load_colmap(tmp_path).image("b.png")), ~left())


def test_a_hidden_photo_is_left_out_and_unknown_masks_are_counted(tmp_path: Path) -> None:
    write_project(tmp_path, names=NAMES)
    put(tmp_path, "b.png", np.zeros((72, 96), bool))
    for name in ("b.jpg", "old", "x/c.png", "deep/x/c.png"):
        put(tmp_path, name, left())
    events: list[Event] = []
    scene = load_colmap(tmp_path, context=Context(emit=events.append))
    assert [image.name for image in scene.images] == ["c.png", "sub/a.png"]
    assert f"Skipped 1 photo, {HIDDEN}: b.png." in warnings(events)
    (unknown,) = [text for text in warnings(events) if "no photo" in text]
    assert unknown.startswith("3 files in ") and "old.png" in unknown  # x/c.png: of a box 'x'


def test_masks_that_hide_every_photo(tmp_path: Path) -> None:
    write_project(tmp_path, names=NAMES)
    for name in NAMES:
        put(tmp_path, name, np.zeros((72, 96), bool))
    with pytest.raises(SceneError, match="3 hidden by its mask") as caught:
        load_colmap(tmp_path)
    assert "--invert-masks" in caught.value.hint


def test_a_mask_of_another_shape_ends_the_load(tmp_path: Path) -> None:
    write_project(tmp_path, names=NAMES, cameras=[camera()])
    put(tmp_path, "b.png", left(72, 96))
    with pytest.raises(MaskError, match="72 x 96 pixels, its photo 96 x 72"):
        load_colmap(tmp_path)
    assert len(load_colmap(tmp_path, masks=MaskOptions(used=False)).images) == 3
