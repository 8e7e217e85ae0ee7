"""Decoding photos and the bounded cache."""

from __future__ import annotations

import struct
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.errors import SceneError
from roigs_engine.machine import machine_memory
from roigs_engine.model.scene import Camera, PhotoMask, PosedImage
from roigs_engine.photos import cache as cache_module
from roigs_engine.photos.cache import PhotoCache
from roigs_engine.photos.decode import decode, load_photo, weighted
from roigs_engine.photos.headers import photo_size
from roigs_engine.photos.mask_images import load_mask, resized, write_mask
from roigs_engine.photos.rotation import turned


def posed(path: Path, width: int, height: int) -> PosedImage:
    return PosedImage(
        name=path.name,
        path=path,
        camera=Camera(width=width, height=height, fx=1.0, fy=1.0, cx=0.0, cy=0.0),
        world_to_camera=np.eye(4),
        point_indices=np.empty(0, dtype=np.int64),
    )


def ramp(width: int, height: int) -> np.ndarray:
    """(H, W, 3) uint8, red rising with x, green with y, blue constant."""
    y, x = (np.mgrid[:height, :width] + 0.5) / [[[height]], [[width]]]
    return np.stack([255 * x, 255 * y, np.full_like(x, 90)], axis=-1).round().astype(np.uint8)


def test_exact_pixels_at_full_size(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (31, 47, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "写真 [1].png")
    loaded = load_photo(posed(tmp_path / "写真 [1].png", 47, 31))
    assert loaded.dtype == np.uint8 and loaded.flags.writeable and loaded.flags.c_contiguous
    np.testing.assert_array_equal(loaded, pixels)


@pytest.mark.parametrize("whole", [(46, 30), (92, 60)])
def test_a_scaled_photo_is_the_average_of_the_whole_one(
    tmp_path: Path, whole: tuple[int, int]
) -> None:
    """So that it can be compared with a render that is one too (`rasterize`, `pixel_size`)."""
    noise = np.random.default_rng(0).integers(0, 256, (60, 92, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "a.png")
    image = posed(tmp_path / "a.png", *whole)
    means = load_photo(image).reshape(whole[1] // 2, 2, whole[0] // 2, 2, 3).mean((1, 3))
    np.testing.assert_allclose(load_photo(image.scaled(0.5)), means, atol=0.51)


@pytest.mark.parametrize("whole", [(639, 427), (320, 214), (641, 429)])
@pytest.mark.parametrize("factor", [0.5, 0.3, 0.75])
def test_averages_of_odd_sizes_keep_places(
    tmp_path: Path, whole: tuple[int, int], factor: float
) -> None:
    """Squares of pixels that do not fit evenly would lie up to half a pixel beside their place."""
    waves = 127.5 + 120 * np.sin(np.arange(640)[None, :, None] / 3.0 + np.zeros((428, 1, 3)))
    Image.fromarray(waves.round().astype(np.uint8)).save(tmp_path / "a.png")
    image = posed(tmp_path / "a.png", *whole).scaled(factor)
    loaded = load_photo(image)[5, :, 0].astype(float) - 127.5
    places = (np.arange(image.camera.width) + 0.5) * 640 / image.camera.width - 0.5
    basis = np.stack([np.sin(places / 3.0), np.cos(places / 3.0)], axis=1)
    (sine, cosine), *_ = np.linalg.lstsq(basis, loaded, rcond=None)
    assert abs(np.arctan2(cosine, sine)) * 3.0 < 0.02  # px
    assert np.abs(basis @ [sine, cosine] - loaded)[3:-3].max() < 3


@pytest.mark.parametrize("suffix", ["png", "jpg"])
@pytest.mark.parametrize("size", [(640, 427), (321, 214), (200, 133), (77, 51), (20, 13)])
def test_resampling_keeps_places(tmp_path: Path, suffix: str, size: tuple[int, int]) -> None:
    """A ramp stays the same ramp, also where JPEG's own reduced decoding is used."""
    path = tmp_path / f"photo.{suffix}"
    Image.fromarray(ramp(1283, 857)).save(path, quality=98, subsampling=0)
    loaded = load_photo(posed(path, *size))
    assert loaded.shape == (size[1], size[0], 3)
    inner = np.s_[2:-2, 2:-2]
    difference = loaded[inner].astype(float) - ramp(*size)[inner]
    assert np.abs(difference).max() < 4 and np.abs(difference.mean(axis=(0, 1))).max() < 0.8


def test_downscaling_averages(tmp_path: Path) -> None:
    """One-pixel stripes become grey, not a moire."""
    stripes = np.zeros((300, 400, 3), dtype=np.uint8)
    stripes[:, ::2] = 255
    Image.fromarray(stripes).save(tmp_path / "a.png")
    small = load_photo(posed(tmp_path / "a.png", 60, 45))
    assert np.abs(small.astype(float) - 127.5).max() < 12


@pytest.mark.parametrize("mode", ["L", "LA", "RGBA", "P", "CMYK", "1", "I;16", "YCbCr", "I", "F"])
def test_pixel_formats(tmp_path: Path, mode: str) -> None:
    grey = np.linspace(0, 255, 40 * 30).reshape(30, 40).astype(np.uint8)
    if mode == "I;16":
        Image.fromarray(grey.astype(np.uint16) * 257).save(tmp_path / "a.png")
    elif mode == "I":
        Image.fromarray(grey.astype(np.int32) * 257).save(tmp_path / "a.tif")
    elif mode == "F":
        Image.fromarray(grey.astype(np.float32) / 255).save(tmp_path / "a.tif")
    elif mode == "1":
        grey = np.where(grey > 127, 255, 0).astype(np.uint8)
        Image.fromarray(grey).convert("1").save(tmp_path / "a.png")
    else:
        suffix = {"CMYK": "tif", "YCbCr": "jpg"}.get(mode, "png")
        colored = Image.fromarray(grey)
        if mode == "P":
            colored.putpalette(bytes(value for level in range(256) for value in [level] * 3))
        elif mode != "L":
            colored = colored.convert("RGB").convert(mode)
        if mode in ("LA", "RGBA"):
            colored.putalpha(0)  # colour under full transparency counts
        colored.save(tmp_path / f"a.{suffix}")
    path = next(tmp_path.iterdir())
    loaded = load_photo(posed(path, 40, 30))
    assert np.abs(loaded.astype(int) - grey[..., None]).max() <= 3


@pytest.mark.parametrize("most", [65535, 16383, 4095, 255])
def test_white_is_that_of_the_type(tmp_path: Path, most: int) -> None:
    """Not the brightest value of each photo, which would brighten dark ones."""
    grey = np.linspace(0, most, 40 * 30).reshape(30, 40).astype(np.uint16)
    Image.fromarray(grey).save(tmp_path / "a.png")
    Image.fromarray(grey.astype(np.float32) / 65535).save(tmp_path / "a.tif")
    for path in tmp_path.iterdir():
        loaded = load_photo(posed(path, 40, 30)).astype(int)
        assert np.abs(loaded - grey[..., None] / 257).max() <= 1


def test_a_tiff_of_32_bits(tmp_path: Path) -> None:
    """Unsigned, which Pillow reads but does not write: the sample format is changed from 2 to 1."""
    values = np.linspace(0, 2**32 - 1, 40 * 30).reshape(30, 40).astype(np.uint32)
    Image.fromarray(values.view(np.int32)).save(tmp_path / "a.tif")
    data = (tmp_path / "a.tif").read_bytes()
    entry = struct.pack("<HHI", 339, 3, 1)
    assert entry + struct.pack("<I", 2) in data
    (tmp_path / "a.tif").write_bytes(data.replace(entry + b"\2", entry + b"\1"))
    loaded = load_photo(posed(tmp_path / "a.tif", 40, 30))
    assert (loaded[..., 0] == values >> 24).all()


def test_a_tiff_of_12_bits(tmp_path: Path) -> None:
    """Two values in three bytes, which Pillow reads but does not write."""
    Image.fromarray(np.zeros((1, 3), np.uint8)).save(tmp_path / "a.tif")
    data = (tmp_path / "a.tif").read_bytes()
    # 3 pixels of 8 bits become 2 of 12: width, bits.
    for tag, old, new in ((256, 3, 2), (258, 8, 12)):
        at = next(k for k in range(8, len(data), 2) if data[k : k + 2] == struct.pack("<H", tag))
        entry = data[at : at + 12]
        assert entry.endswith(struct.pack("<I", old))
        data = data.replace(entry, entry[:8] + struct.pack("<I", new))
    (tmp_path / "a.tif").write_bytes(data[:-3] + b"\xff\xf8\x00")
    loaded = load_photo(posed(tmp_path / "a.tif", 2, 1))
    assert loaded[0, :, 0].tolist() == [255, 128]


def test_orientation_is_ignored(tmp_path: Path) -> None:
    photo = Image.fromarray(ramp(40, 30))
    exif = photo.getexif()
    exif[0x0112] = 8
    photo.save(tmp_path / "a.jpg", exif=exif, quality=98, subsampling=0)
    assert photo_size(tmp_path / "a.jpg") == (40, 30)
    loaded = load_photo(posed(tmp_path / "a.jpg", 40, 30))
    assert np.abs(loaded.astype(int) - ramp(40, 30)).max() < 8


@pytest.mark.parametrize("damage", ["missing", "text", "cut", "empty", "folder"])
def test_unreadable_photos_are_named(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "photo 7.jpg"
    if damage == "cut":
        Image.fromarray(ramp(200, 150)).save(path)
        path.write_bytes(path.read_bytes()[:1500])
    elif damage == "folder":
        path.mkdir()
    elif damage != "missing":
        path.write_bytes(b"" if damage == "empty" else b"hello")
    with pytest.raises(SceneError) as caught:
        load_photo(posed(path, 200, 150))
    assert "photo 7.jpg" in caught.value.message


# --- cache ----------------------------------------------------------------------------------------


@pytest.fixture
def photos(tmp_path: Path) -> list[PosedImage]:
    """Six photos of 20 x 10 pixels (600 bytes), photo i filled with the value i."""
    for index in range(6):
        Image.new("RGB", (20, 10), (index,) * 3).save(tmp_path / f"{index}.png")
    return [posed(tmp_path / f"{index}.png", 20, 10) for index in range(6)]


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the photos as they are decoded."""
    names: list[str] = []

    def spy(image: PosedImage) -> np.ndarray:
        names.append(image.name)
        return load_photo(image)

    monkeypatch.setattr(cache_module, "load_masked", spy)
    return names


def test_the_cache_drops_the_least_recently_used(
    photos: list[PosedImage], decoded: list[str]
) -> None:
    with PhotoCache(photos, limit_bytes=1800) as cache:
        assert len(cache) == 6
        for index in (0, 1, 2, 0, 3):
            assert cache[index][0, 0].tolist() == [index] * 3
        assert cache.kept_bytes == 1800
        assert decoded == ["0.png", "1.png", "2.png", "3.png"]
        assert cache[0] is cache[0] and cache[-4] is cache[2]
        assert len(decoded) == 4
        assert cache[1][0, 0, 0] == 1
        assert decoded[-1] == "1.png" and len(decoded) == 5


def test_a_cache_too_small_for_one_photo_still_serves(photos: list[PosedImage]) -> None:
    with PhotoCache(photos, limit_bytes=10) as cache:
        assert [int(cache[index][0, 0, 0]) for index in range(6)] == list(range(6))
        assert cache.kept_bytes == 0
        cache.prefetch(range(6))
    with pytest.raises(IndexError):
        cache[6]


def test_prefetch_decodes_each_photo_once(photos: list[PosedImage], decoded: list[str]) -> None:
    with PhotoCache(photos, limit_bytes=12_000) as cache:
        cache.prefetch([3, 4, 3, 5])
        for index in (3, 4, 5):
            assert cache[index][0, 0, 0] == index
        cache.prefetch([3, 4])
    assert sorted(decoded) == ["3.png", "4.png", "5.png"]


def test_prefetch_works_ahead(photos: list[PosedImage]) -> None:
    with PhotoCache(photos) as cache:
        cache.prefetch(range(6))
        end = time.monotonic() + 10
        while cache.kept_bytes < 6 * 600 and time.monotonic() < end:
            time.sleep(0.01)
        assert cache.kept_bytes == 6 * 600


def test_prefetch_does_not_push_out_what_it_fetched(
    photos: list[PosedImage], decoded: list[str]
) -> None:
    with PhotoCache(photos, limit_bytes=2400) as cache:
        cache.prefetch(range(6))  # half of 2400 bytes: two photos
        assert cache[0] is cache[0] and cache[1] is cache[1]
    assert sorted(decoded) == ["0.png", "1.png"]


def test_an_unreadable_photo_raises_when_asked_for(photos: list[PosedImage]) -> None:
    photos[2].path.write_bytes(b"damaged")
    with PhotoCache(photos) as cache:
        cache.prefetch(range(4))
        for _ in range(2):
            with pytest.raises(SceneError, match=r"2\.png"):
                cache[2]
        assert cache[3][0, 0, 0] == 3


def test_many_threads_at_once(photos: list[PosedImage]) -> None:
    wrong: list[int] = []

    def read(seed: int) -> None:
        for index in np.random.default_rng(seed).integers(0, 6, 300):
            if cache[int(index)][0, 0, 0] != index:
                wrong.append(int(index))
            if index == seed:
                cache.prefetch(range(6))

    with PhotoCache(photos, limit_bytes=2500) as cache:
        threads = [threading.Thread(target=read, args=(seed,)) for seed in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30)
        assert not any(thread.is_alive() for thread in threads)
        assert cache.kept_bytes <= 2500
    assert not wrong


def test_a_closed_cache_holds_nothing(photos: list[PosedImage]) -> None:
    cache = PhotoCache(photos)
    cache.prefetch(range(6))
    cache.close()
    cache.close()
    cache.prefetch(range(6))
    assert cache.kept_bytes == 0
    assert cache[4][0, 0, 0] == 4
    assert cache.kept_bytes == 0


def test_machine_memory_is_plausible() -> None:
    assert 64 << 20 <= machine_memory() < 1 << 50


# --- masks and alpha ------------------------------------------------------------------------------


def covered(ignored: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(h, w) the pixels at `size` that cover an ignored one, even in part: by looking at each."""
    height, width = ignored.shape
    found = np.zeros(size[::-1], bool)
    for y, x in np.argwhere(ignored):
        top, left = y * size[1] // height, x * size[0] // width
        found[top : -(-(y + 1) * size[1] // height), left : -(-(x + 1) * size[0] // width)] = True
    return found


@pytest.mark.parametrize("across", [400, 320, 213, 97, 639, 800, 1000])
@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_ignored_pixels_leave_no_colour_at_any_factor(
    tmp_path: Path, across: int, suffix: str
) -> None:
    random = np.random.default_rng(across)
    size = (across, round(across * 0.75))
    ignored = np.kron(random.random((30, 40)) < 0.02, np.ones((16, 16), bool))
    if suffix == "png":  # not within the blocks of a JPEG
        ignored |= random.random((480, 640)) < 0.0005
    photo = np.where(ignored, 0, 128).astype(np.uint8)
    Image.fromarray(photo).save(tmp_path / f"a.{suffix}", quality=100)
    kept = resized(~ignored, size)
    assert np.array_equal(kept, ~covered(ignored, size))
    pixels = decode(tmp_path / f"a.{suffix}", size, counted=lambda: ~ignored)
    assert np.abs(pixels[kept].astype(int) - 128).max() <= 1


def test_a_mask_changes_no_colour_far_from_it(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "a.png")
    mask = np.arange(64) < 32 + np.zeros((48, 1), int)
    plain = decode(tmp_path / "a.png", (40, 30))
    assert np.array_equal(
        decode(tmp_path / "a.png", (40, 30), counted=lambda: mask)[:, :15], plain[:, :15]
    )
    assert np.array_equal(decode(tmp_path / "a.png", (64, 48), counted=lambda: mask), noise)


@pytest.mark.parametrize("size", [(200, 150), (333, 251), (130, 65), (700, 467)])
def test_tiles_join_without_seams(tmp_path: Path, size: tuple[int, int]) -> None:
    """The same as weighing the whole photo at once."""
    random = np.random.default_rng(1)
    noise = random.integers(0, 256, (240, 320, 3), dtype=np.uint8)
    mask = random.random((240, 320)) > 0.01
    mask[:80] = False
    Image.fromarray(noise).save(tmp_path / "a.png")
    whole = weighted(noise, mask, lambda picture: picture.resize(size, Image.Resampling.LANCZOS))
    tiled = decode(tmp_path / "a.png", size, counted=lambda: mask)
    assert np.abs(tiled.astype(int) - whole).max() <= 1


def test_a_posed_photo_is_resampled_by_its_mask(tmp_path: Path) -> None:
    """Also at a part of its size, and turned."""
    mask = np.random.default_rng(0).random((120, 160)) > 0.01
    Image.fromarray(np.where(mask, 128, 0).astype(np.uint8)).save(tmp_path / "a.png")
    for turn in (1, 6):
        size = (100, 75) if turn == 1 else (75, 100)
        whole = turned(mask, turn)
        path = tmp_path / f"mask-{turn}.png"
        made = PhotoMask(
            digest="m",
            path=path,
            remake=partial(write_mask, path, resized(whole, size)),
            small=np.zeros((1, 1), np.uint8),
            whole=lambda whole=whole: whole,
        )
        image = replace(posed(tmp_path / "a.png", *size), mask=made, turn=turn)
        for scaled in (image, image.scaled(0.5)):
            kept = load_mask(scaled)
            assert kept is not None and 0.2 < kept.mean() < 1
            assert np.abs(load_photo(scaled)[kept].astype(int) - 128).max() <= 1


@pytest.mark.parametrize("mode", ["RGBA", "LA", "P"])
def test_cut_outs_have_no_dark_rim(tmp_path: Path, mode: str) -> None:
    y, x = np.mgrid[:96, :128]
    inside = (x - 64) ** 2 + (y - 48) ** 2 < 30**2
    grey = np.where(inside, 200, 0).astype(np.uint8)
    alpha = (inside * 255).astype(np.uint8)
    if mode == "P":
        cut = Image.fromarray(inside.astype(np.uint8))
        cut.putpalette([0, 0, 0, 200, 200, 200])
        cut.save(tmp_path / "a.png", transparency=0)
    else:
        cut = Image.merge(
            mode, [Image.fromarray(grey)] * (len(mode) - 1) + [Image.fromarray(alpha)]
        )
        cut.save(tmp_path / "a.png")
    small = decode(tmp_path / "a.png", (50, 37))
    seen = np.asarray(Image.fromarray(alpha).resize((50, 37), Image.Resampling.BOX)) > 25
    assert np.abs(small[seen].astype(int) - 200).max() <= 1
    assert (small[:5] == 0).all()  # where nothing is seen, the colours of the file
