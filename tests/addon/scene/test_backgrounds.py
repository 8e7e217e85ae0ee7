"""Photos behind cameras: the user's files, or pictures of them as training sees them."""

from __future__ import annotations

import json
import time
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests.addon.colmap_project import HEIGHT, PARAMS, WIDTH, write_png, write_project
from tests.addon.scenes import imported

Image = pytest.importorskip("PIL.Image")
BEND = -0.25


def slope(rays: np.ndarray) -> np.ndarray:
    """(..., 3) colours 0 to 255 of directions (..., 2): brighter to the right and below."""
    x, y = np.moveaxis(rays, -1, 0)
    return np.stack([128 + 180 * x, 128 + 180 * y, 0 * x + 90], axis=-1)


def rays(fx: float, fy: float, cx: float, cy: float, size: tuple[int, int]) -> np.ndarray:
    """(H, W, 2) directions of the pixels of a pinhole."""
    x, y = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    return np.stack([(x - cx) / fx, (y - cy) / fy], axis=-1)


@pytest.fixture
def bent(tmp_path: Path) -> Path:
    """A project of photos that a lens with distortion has taken of `slope`."""
    pytest.importorskip("pycolmap")
    folder = write_project(tmp_path / "bent", bend=BEND)
    numbers = " ".join(map(str, (WIDTH, HEIGHT, *PARAMS, BEND, 0, 0, 0)))
    (folder / "sparse/0/cameras.txt").write_text(f"1 OPENCV {numbers}\n")
    seen = rays(*PARAMS, (WIDTH, HEIGHT))
    straight = seen
    for _ in range(50):  # the directions that the lens shows there
        straight = seen / (1 + BEND * (straight**2).sum(axis=-1, keepdims=True))
    for file in (folder / "images").iterdir():
        write_png(file, slope(straight).clip(0, 255).round().astype(np.uint8))
    return folder


def background(scene: object) -> tuple[Path, np.ndarray]:
    """The file behind the scene's camera, and its pixels, the upper row first."""
    (shown,) = scene.camera.data.background_images
    image = shown.image
    width, height = image.size
    pixels = np.array(image.pixels[:]).reshape(height, width, -1)[::-1, :, :3]
    return Path(image.filepath), 255 * pixels


def test_a_photo_is_shown_without_its_distortion(
    blender: ModuleType, addon: ModuleType, bent: Path
) -> None:
    from roigs_addon.scene import backgrounds, lookup, masks

    scene = imported(blender, bent)
    for photo in ("photo 3.png", "photo 4.png", "photo 3.png"):
        blender.ops.roigs.look_through(photo=photo)
        path, found = background(scene)
        assert path.suffix == ".jpg" and bent not in path.parents
    camera = json.loads(scene.camera.roigs.photo)
    size = (camera["width"], camera["height"])
    right = slope(rays(*(camera[key] for key in ("fx", "fy", "cx", "cy")), size)).clip(0, 255)
    assert found.shape == right.shape
    assert np.abs(found - right).max() < 6
    assert len(scene.camera.data.background_images) == 1
    shown = lookup.photo_record(scene.camera)
    assert masks.size_of(shown) == (WIDTH, HEIGHT)  # of the file, on which strokes are drawn
    assert backgrounds.with_distortion(shown) == bent / "images/photo 3.png"


def test_a_changed_photo_and_a_lost_picture_are_made_again(
    blender: ModuleType, addon: ModuleType, bent: Path
) -> None:
    scene = imported(blender, bent)
    blender.ops.roigs.look_through(photo="photo 3.png")
    first, _ = background(scene)
    write_png(bent / "images/photo 3.png", np.full((HEIGHT, WIDTH, 3), 200, np.uint8))
    blender.ops.roigs.look_through(photo="photo 3.png")
    second, found = background(scene)
    assert second != first and np.abs(found - 200).max() < 4
    second.unlink()
    blender.ops.roigs.look_through(photo="photo 3.png")
    assert second.is_file() and background(scene)[0] == second
    (shown,) = scene.camera.data.background_images
    shown.image.filepath = "/another/computer/cache/photos/0.jpg"
    blender.ops.roigs.look_through(photo="photo 3.png")
    assert background(scene)[0] == second


def test_only_pictures_of_ours_are_removed(
    blender: ModuleType, addon: ModuleType, bent: Path, tmp_path: Path, monkeypatch
) -> None:
    """The user may have named a folder of photos as Cache Folder."""
    from roigs_addon import settings
    from roigs_addon.scene import backgrounds

    scene = imported(blender, bent)
    folder = tmp_path / "photos"
    folder.mkdir()
    monkeypatch.setattr(settings, "pictures_folder", lambda: folder)
    monkeypatch.setattr(backgrounds, "KEPT", 1)
    theirs = [folder / name for name in ("a.jpg", f"{'0a' * 16}.jpg", "roigs-holiday.jpg")]
    for file in theirs:
        file.write_bytes(b"a photo")
    made = []
    for number in (3, 4, 5):
        blender.ops.roigs.look_through(photo=f"photo {number}.png")
        made.append(background(scene)[0])
    assert sorted(folder.iterdir()) == sorted([*theirs, *made[1:]])


def test_other_files_are_shown_as_training_sees_them(
    blender: ModuleType, addon: ModuleType, tmp_path: Path
) -> None:
    project = write_project(tmp_path / "project")
    images = project / "images"
    cmyk = Image.fromarray(np.full((HEIGHT, WIDTH, 3), 100, np.uint8)).convert("CMYK")
    cmyk.save(images / "photo 1.jpg", quality=95)
    deep = np.full((HEIGHT, WIDTH), 0x8000, np.uint16)
    Image.fromarray(deep).save(images / "photo 2.tif")
    for model in (project / "sparse/0").iterdir():
        text = model.read_text().replace("photo 2.png", "photo 2.tif")
        model.write_text(text.replace("photo 1.png", "photo 1.jpg"))
    scene = imported(blender, project)
    blender.ops.roigs.look_through(photo="photo 2.tif")
    path, found = background(scene)
    assert path.suffix == ".jpg" and np.abs(found - 128).max() < 2
    blender.ops.roigs.look_through(photo="photo 1.jpg")
    path, found = background(scene)
    assert path.parent != images and np.abs(found - 100).max() < 4
    blender.ops.roigs.look_through(photo="photo 0.png")
    assert background(scene)[0] == images / "photo 0.png"


def test_a_user_s_own_background_stays(
    blender: ModuleType, addon: ModuleType, bent: Path, tmp_path: Path
) -> None:
    scene = imported(blender, bent)
    blender.ops.roigs.look_through(photo="photo 3.png")
    write_png(tmp_path / "mine.png", np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    (shown,) = scene.camera.data.background_images
    shown.image = blender.data.images.load(str(tmp_path / "mine.png"))
    blender.ops.roigs.look_through(photo="photo 3.png")
    assert background(scene)[0] == tmp_path / "mine.png"


def test_in_a_window_the_file_is_shown_until_the_picture_is_there(
    blender: ModuleType, addon: ModuleType, bent: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.scene import backgrounds

    scene, started = imported(blender, bent), list[str]()
    monkeypatch.setattr(backgrounds, "in_background", lambda: False)
    monkeypatch.setattr(backgrounds._timer, "start", lambda: started.append("timer"))
    for photo in ("photo 2.png", "photo 3.png"):
        blender.ops.roigs.look_through(photo=photo)
        assert background(scene)[0] == bent / "images" / photo
    assert started
    end = time.monotonic() + 60
    while backgrounds._step() and time.monotonic() < end:
        time.sleep(0.02)
    assert background(scene)[0].suffix == ".jpg"  # only that of the photo looked through last
    assert len(list(background(scene)[0].parent.glob("*.jpg"))) >= 1


def test_without_an_engine_the_file_is_shown(
    blender: ModuleType,
    addon: ModuleType,
    bent: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from roigs_addon import settings
    from roigs_addon.errors import AddonError

    def missing(packages: tuple[str, ...]) -> None:
        raise AddonError("There is no engine.")

    scene = imported(blender, bent)
    monkeypatch.setattr(settings, "engine", missing)
    for _ in range(2):
        blender.ops.roigs.look_through(photo="photo 3.png")
        assert background(scene)[0] == bent / "images/photo 3.png"
    said = capsys.readouterr().out
    assert said.count("The photo is shown as it is stored. There is no engine.") == 1


def test_beside_gaussians_no_photo_is_behind_them(blender: ModuleType, run) -> None:
    scene, _ = run
    name = next(item.name for item in scene.objects if item.roigs.kind == "CAMERA")
    blender.ops.roigs.look_through(photo=name)
    (shown,) = scene.camera.data.background_images
    assert shown.show_background_image, "without Gaussians there is nothing to compare"
    blender.ops.roigs.load_results()
    blender.context.view_layer.update()
    assert not shown.show_background_image
    scene.roigs.compare_photo = False
    blender.context.view_layer.update()
    assert shown.show_background_image
    scene.roigs.compare_photo = True
    blender.context.view_layer.update()
    assert not shown.show_background_image
    for item in [item for item in scene.objects if item.roigs.kind == "SPLATS"]:
        blender.data.objects.remove(item)
    blender.context.view_layer.update()
    assert shown.show_background_image
