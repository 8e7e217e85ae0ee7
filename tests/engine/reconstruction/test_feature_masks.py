"""Masks of photos to reconstruct: found by training's rule, kept in one folder for pycolmap."""

from __future__ import annotations

import json
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

from roigs_engine.context import QUIET, Context
from roigs_engine.formats.events import Event, Message
from roigs_engine.formats.files import sha256
from roigs_engine.photos import mask_images
from roigs_engine.photos.mask_images import stored_mask
from roigs_engine.photos.mask_paths import MaskFiles, MaskOptions
from roigs_engine.reconstruction import feature_masks
from roigs_engine.reconstruction.feature_masks import write_masks
from roigs_engine.reconstruction.folder import Folder
from roigs_engine.reconstruction.photo_checks import look_at

NAMES = ("a.png", "sub/b.png", "c.png", "d.png")


def scene(folder: Path) -> Folder:
    """Four photos: with a mask file, one beside it, an alpha channel, and an opaque one."""
    made = Folder(folder / "scene")
    left = np.zeros((30, 40), bool)
    left[:, :20] = True
    for k, name in enumerate(NAMES):
        photo = Image.effect_noise((40, 30), 20 + k).convert("RGB")
        if name in ("c.png", "d.png"):
            photo.putalpha(Image.fromarray(left | (name == "d.png")).convert("L"))
        path = made.images / name
        path.parent.mkdir(parents=True, exist_ok=True)
        photo.save(path)
    (folder / "scene/masks").mkdir()
    Image.fromarray(left.astype(np.uint16) * 9).save(folder / "scene/masks/a.png.png")
    Image.fromarray(left).save(folder / "scene/images/sub/b.mask.png")
    return made


def test_masks_of_all_kinds_are_written_for_pycolmap(tmp_path: Path) -> None:
    folder, events = scene(tmp_path), list[Event]()
    files = folder.photos_of(folder.images)
    assert set(files) == set(NAMES)  # the mask beside b is no photo
    photos = look_at(files, tmp_path / "photos.json", QUIET).photos
    context = Context(emit=events.append)
    masks = write_masks(photos, folder.images, MaskOptions(), folder, context)
    assert set(masks) == {"a.png", "sub/b.png", "c.png"}
    for name in masks:
        mask = stored_mask(folder.masks / f"{name}.png")
        assert mask[:, :20].all() and not mask[:, 20:].any()
    (said,) = [e.text for e in events if isinstance(e, Message)]
    assert said.startswith("3 photos with a mask")
    # Training finds them, and does not invert them again.
    (folder.images / "sub/b.mask.png").unlink()
    found = MaskFiles(folder.images)
    made = found.find("sub/b.png")
    assert made is not None and found.is_made(made)
    assert MaskFiles(folder.images, tmp_path).find("sub/b.png") is None


def test_other_masks_are_other_features(tmp_path: Path) -> None:
    folder = scene(tmp_path)
    photos = look_at(folder.photos_of(folder.images), tmp_path / "photos.json", QUIET).photos
    plain = write_masks(photos, folder.images, MaskOptions(used=False), folder, QUIET)
    assert plain == {}
    first = write_masks(photos, folder.images, MaskOptions(), folder, QUIET)
    options = MaskOptions(inverted=True)
    second = write_masks(photos, folder.images, options, folder, QUIET)
    assert first and second and first != second
    assert not stored_mask(folder.masks / "a.png.png")[:, :20].any()
    assert stored_mask(folder.masks / "c.png.png")[:, :20].all()  # an alpha channel stays


def test_hidden_photos_are_named(tmp_path: Path) -> None:
    folder, events = scene(tmp_path), list[Event]()
    Image.new("1", (40, 30)).save(tmp_path / "scene/masks/a.png.png")
    photos = look_at(folder.photos_of(folder.images), tmp_path / "photos.json", QUIET).photos
    write_masks(photos, folder.images, MaskOptions(), folder, Context(emit=events.append))
    warned = [e.text for e in events if isinstance(e, Message) and e.level == "warning"]
    assert warned == ["1 photo hidden by its mask: a.png."]


def test_an_alpha_channel_is_decoded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of c and d; when it is done again, of the opaque one alone, which has no file."""
    folder, decoded = Folder(tmp_path / "out"), list[Path]()
    source = scene(tmp_path).images
    alpha_mask = mask_images.alpha_mask
    monkeypatch.setattr(mask_images, "alpha_mask", lambda p: decoded.append(p) or alpha_mask(p))
    photos = look_at(folder.photos_of(source), tmp_path / "photos.json", QUIET).photos
    first = write_masks(photos, source, MaskOptions(), folder, QUIET)
    assert sorted(path.name for path in decoded) == ["c.png", "d.png"]
    assert write_masks(photos, source, MaskOptions(), folder, QUIET) == first
    assert [path.name for path in decoded[2:]] == ["d.png"]


def test_photos_in_the_project_have_the_same_masks_again(tmp_path: Path) -> None:
    """`reconstruct SCENE/images --out SCENE`: a mask that was made is none that a photo has."""
    folder = scene(tmp_path)
    photos = look_at(folder.photos_of(folder.images), tmp_path / "photos.json", QUIET).photos
    first = write_masks(photos, folder.images, MaskOptions(), folder, QUIET)
    assert write_masks(photos, folder.images, MaskOptions(), folder, QUIET) == first
    # As in a record of an older version.
    record = folder.work("masks.json")
    record.write_text(json.dumps(first))
    assert write_masks(photos, folder.images, MaskOptions(), folder, QUIET) == first
    moved = Folder((tmp_path / "scene").rename(tmp_path / "moved"))
    photos = look_at(moved.photos_of(moved.images), tmp_path / "photos.json", QUIET).photos
    assert write_masks(photos, moved.images, MaskOptions(), moved, QUIET) == first


def test_masks_that_a_person_removed_are_removed(tmp_path: Path) -> None:
    folder = scene(tmp_path)
    photos = look_at(folder.photos_of(folder.images), tmp_path / "photos.json", QUIET).photos
    write_masks(photos, folder.images, MaskOptions(), folder, QUIET)
    mine = folder.masks / "sub/b.png.png"
    Image.new("1", (40, 30), 1).save(mine)
    (tmp_path / "scene/masks/a.png.png").unlink()
    (tmp_path / "scene/images/sub/b.mask.png").unlink()
    assert set(write_masks(photos, folder.images, MaskOptions(), folder, QUIET)) == {"c.png"}
    assert not (folder.masks / "a.png.png").exists() and mine.exists()  # a person painted that
    assert write_masks(photos, folder.images, MaskOptions(used=False), folder, QUIET) == {}
    assert not (folder.masks / "c.png.png").exists()


def test_masks_beside_the_first_photos_stay(tmp_path: Path) -> None:
    """The photos were elsewhere; from now on the project's own are given."""
    source, folder = scene(tmp_path).images, Folder(tmp_path / "out")
    photos = look_at(folder.photos_of(source), tmp_path / "photos.json", QUIET).photos
    folder.take_photos(list(photos))
    first = write_masks(photos, source, MaskOptions(), folder, QUIET)
    photos = look_at(folder.photos_of(folder.images), tmp_path / "own.json", QUIET).photos
    for _ in range(2):
        assert write_masks(photos, folder.images, MaskOptions(), folder, QUIET) == first
    assert all((folder.masks / f"{name}.png").exists() for name in first)


@pytest.mark.parametrize("record", ["5", '{"a.png": [1]}', '{"a.png": {"digest": 1, "x": 2}}'])
def test_a_damaged_record_is_made_anew(tmp_path: Path, record: str) -> None:
    folder = scene(tmp_path)
    photos = look_at(folder.photos_of(folder.images), tmp_path / "photos.json", QUIET).photos
    first = write_masks(photos, folder.images, MaskOptions(), folder, QUIET)
    folder.work("masks.json").write_text(record)
    assert write_masks(photos, folder.images, MaskOptions(), folder, QUIET) == first


def test_a_record_names_no_file_outside(tmp_path: Path) -> None:
    folder = scene(tmp_path)
    photos = look_at(folder.photos_of(folder.images), tmp_path / "photos.json", QUIET).photos
    other = tmp_path / "scene/masks/a.png.png"
    entry = {"digest": "", "sha256": sha256(other), "photos": ""}
    folder.masks.mkdir(parents=True)
    folder.work("masks.json").write_text(json.dumps({"../../masks/a.png": entry}))
    write_masks(photos, folder.images, MaskOptions(used=False), folder, QUIET)
    assert other.exists()


def test_masks_of_a_killed_engine_are_not_taken_for_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mask, then another until the engine is killed, then the first again."""
    folder = scene(tmp_path)
    photos = look_at(folder.photos_of(folder.images), tmp_path / "photos.json", QUIET).photos
    file = tmp_path / "scene/masks/a.png.png"
    first, other = file.read_bytes(), Image.fromarray(np.eye(30, 40) > 0)
    write_masks(photos, folder.images, MaskOptions(), folder, QUIET)
    made = sha256(folder.masks / "a.png.png")
    other.save(file)
    with monkeypatch.context() as killed:
        killed.setattr(feature_masks, "_forget", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            write_masks(photos, folder.images, MaskOptions(), folder, QUIET)
    assert sha256(folder.masks / "a.png.png") != made
    file.write_bytes(first)
    write_masks(photos, folder.images, MaskOptions(), folder, QUIET)
    assert sha256(folder.masks / "a.png.png") == made
