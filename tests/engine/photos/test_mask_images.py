"""Masks of photos: where they are, every kind of file, and what cannot be one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.errors import ConfigError
from roigs_engine.model.scene import Camera, PhotoMask, PosedImage
from roigs_engine.photos import mask_images
from roigs_engine.photos.cache import PhotoCache
from roigs_engine.photos.files import PhotoFolder
from roigs_engine.photos.mask_images import (
    MaskError,
    alpha_mask,
    has_alpha,
    load_mask,
    load_masked,
    read_mask,
    resized,
    write_mask,
)
from roigs_engine.photos.mask_paths import MaskFiles, MaskOptions

SIZE = (40, 30)
HALF = np.zeros((30, 40), bool)
HALF[:, 20:] = True


def put(path: Path) -> Path:
    """A mask that counts the right half."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(HALF).save(path)
    return path


@pytest.mark.parametrize(
    "name",
    [
        "masks/sub/a.jpg.png",
        "masks/sub/a.png",
        "masks/sub/a.mask.png",
        "masks/sub/a.jpg.mask.png",
        "masks/Sub/A.JPG.png",
        "images/sub/a.mask.png",
        "images/sub/a.jpg.mask.png",
    ],
)
def test_the_mask_of_a_photo_is_found(tmp_path: Path, name: str) -> None:
    mask = put(tmp_path / name)
    files = MaskFiles(tmp_path / "images")
    found = files.find("sub/a.jpg")
    assert found is not None and found.samefile(mask)
    assert files.find("sub\\a.jpg") == found
    assert files.find("sub/b.jpg") is None and files.find("a.jpg") is None
    assert files.unknown(["sub/a.jpg"]) == []
    assert len(files.unknown(["b.jpg"])) == 1


def test_colmaps_name_comes_first_and_another_folder_replaces_the_usual(tmp_path: Path) -> None:
    colmap = put(tmp_path / "masks/a.jpg.png")
    put(tmp_path / "masks/a.png")
    put(tmp_path / "images/a.mask.png")
    other = put(tmp_path / "other/a.png")
    images = tmp_path / "images"
    assert MaskFiles(images).find("a.jpg") == colmap
    assert MaskFiles(images, tmp_path / "other").find("a.jpg") == other


def test_masks_of_boxes_and_of_other_kinds(tmp_path: Path) -> None:
    """Those of boxes are known by the photo's name; a mask that is no PNG is named."""
    put(tmp_path / "masks/vase/a.jpg.png")
    Image.fromarray(HALF).convert("L").save(tmp_path / "masks/a.jpg")
    files = MaskFiles(tmp_path / "images")
    assert files.find("a.jpg") is None
    assert files.unknown(["a.jpg"]) == ["a.jpg"]


def test_a_photo_is_not_its_own_mask(tmp_path: Path) -> None:
    put(tmp_path / "images/a.png")
    mask = put(tmp_path / "images/b.jpg.png")
    files = MaskFiles(tmp_path / "images", tmp_path / "images")
    assert files.find("a.png") is None and files.find("a.jpg") is None
    assert files.find("b.jpg") == mask


def test_masks_among_photos_are_no_photos(tmp_path: Path) -> None:
    put(tmp_path / "a.mask.png")
    put(tmp_path / "a.png")
    assert PhotoFolder(tmp_path).others([]) == ["a.png"]
    assert PhotoFolder(tmp_path).find("a.mask.png") is not None  # a model may name it


def test_a_folder_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is not a folder"):
        MaskOptions(folder=tmp_path / "none").check()


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA", "I;16", "one", "clear"])
def test_masks_of_any_depth(tmp_path: Path, mode: str) -> None:
    path, bright = tmp_path / "a.png", HALF.astype(np.uint8)
    if mode == "I;16":
        Image.fromarray(HALF.astype(np.uint16) * 7).save(path)  # 7 of 65,535 is not black
    elif mode == "one":  # as labels are written
        Image.fromarray(bright).save(path)
    elif mode == "clear":  # white everywhere, transparent on the left
        white = np.full((30, 40, 4), 255, np.uint8)
        white[..., 3] *= bright
        Image.fromarray(white).save(path)
    elif mode == "P":
        labels = Image.fromarray(bright * 3)
        labels.putpalette([0, 0, 0, 9, 9, 9, 0, 0, 0, 128, 0, 0])
        labels.save(path)
    else:
        Image.fromarray(bright * 255).convert(mode).save(path)
    assert np.array_equal(read_mask(path, SIZE), HALF)
    assert np.array_equal(read_mask(path, SIZE, inverted=True), ~HALF)
    assert np.array_equal(read_mask(path, (400, 300)), HALF)  # smaller than the photo


def test_alpha_channels(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    Image.new("RGB", SIZE).save(path)
    assert not has_alpha(path) and not has_alpha(tmp_path / "none")
    photo = np.full((30, 40, 4), 90, np.uint8)
    photo[..., 3] = np.where(HALF, 200, 100)
    for suffix in ("png", "webp", "tif"):
        path = tmp_path / f"b.{suffix}"
        Image.fromarray(photo).save(path)
        assert has_alpha(path)
        assert np.array_equal(alpha_mask(path)[:, 2:18], HALF[:, 2:18])


def damaged(path: Path, kind: str) -> None:
    if kind == "animation":
        frames = [Image.new("L", SIZE, value) for value in (0, 255)]
        frames[0].save(path, save_all=True, append_images=frames[1:])
    elif kind == "turned":
        Image.fromarray(HALF.T.copy()).save(path)
    elif kind == "jpeg":
        Image.new("L", SIZE).save(path, "JPEG")
    elif kind == "cut":
        Image.effect_noise(SIZE, 50).save(path)
        path.write_bytes(path.read_bytes()[:300])
    else:
        path.write_bytes(b"" if kind == "empty" else b"no picture")


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("empty", "the file is empty"),
        ("text", "it is no PNG"),
        ("jpeg", "it is no PNG"),
        ("cut", "Cannot read the mask"),
        ("animation", "is an animation"),
        ("turned", "has 30 x 40 pixels, its photo 40 x 30: another shape"),
        ("missing", "No such file"),
    ],
)
def test_what_is_no_mask_is_named_in_one_line(tmp_path: Path, kind: str, said: str) -> None:
    path = tmp_path / "a.jpg.png"
    if kind != "missing":
        damaged(path, kind)
    with pytest.raises(MaskError) as caught:
        read_mask(path, SIZE)
    assert said in caught.value.message and str(path) in caught.value.message
    assert caught.value.hint and "\n" not in caught.value.message


def test_a_mask_far_larger_than_its_photo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A megabyte of PNG may hold 170 megapixels, which take minutes."""
    Image.new("1", (400, 300)).save(tmp_path / "a.png")
    read_mask(tmp_path / "a.png", SIZE)
    monkeypatch.setattr(mask_images, "MOST_PIXELS", 100_000)
    with pytest.raises(MaskError, match="400 x 300 pixels"):
        read_mask(tmp_path / "a.png", SIZE)
    read_mask(tmp_path / "a.png", (400, 300))


def test_a_pixel_that_covers_an_ignored_one_is_ignored() -> None:
    mask = np.ones((30, 40), bool)
    mask[7, 11] = False
    small = resized(mask, (10, 10))
    assert np.argwhere(~small).tolist() == [[2, 2]]
    large = resized(mask, (80, 60))
    assert np.argwhere(~large).tolist() == [[14, 22], [14, 23], [15, 22], [15, 23]]


def posed(tmp_path: Path, mask: np.ndarray | None) -> PosedImage:
    pixels = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    made = None
    if mask is not None:
        path = tmp_path / "made.png"
        made = PhotoMask(
            digest="m", path=path, remake=lambda: write_mask(path, mask), small=np.zeros((1, 1))
        )
    return PosedImage(
        name="a.png",
        path=tmp_path / "a.png",
        camera=Camera(width=40, height=30, fx=1.0, fy=1.0, cx=0.0, cy=0.0),
        world_to_camera=np.eye(4),
        point_indices=np.empty(0, dtype=np.int64),
        mask=made,
    )


def test_a_lost_or_damaged_mask_of_the_engine_is_made_again(tmp_path: Path) -> None:
    image = posed(tmp_path, HALF)
    assert image.mask is not None
    loaded = load_mask(image)
    assert loaded is not None and np.array_equal(loaded, HALF)
    image.mask.path.write_bytes(b"damaged")
    again = load_mask(image)
    assert again is not None and np.array_equal(again, HALF)
    assert image.mask.path.stat().st_size < 200  # 1 bit for a pixel


def test_the_cache_keeps_a_byte_for_a_pixel_of_a_mask(tmp_path: Path) -> None:
    plain, masked = posed(tmp_path, None), posed(tmp_path, HALF)
    assert load_masked(plain).shape == (30, 40, 3)
    with PhotoCache([plain, masked]) as cache:
        assert np.array_equal(cache[1][..., :3], cache[0])
        assert np.array_equal(cache[1][..., 3], HALF * np.uint8(255))
        assert cache.kept_bytes == plain.decoded_bytes + masked.decoded_bytes == 7 * 1200
