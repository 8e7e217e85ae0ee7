"""Inputs of benchmarks and window stories of masks: true masks, strokes, the photos of a run."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks import object_masks, scribbles
from roigs_engine.formats.scribbles import OBJECT, Scribble, Stroke
from roigs_engine.model.roi import OrientedBox
from roigs_engine.photos.mask_images import write_mask
from tools.window import scribble as window

BOX = OrientedBox.between("pot", [-1, -1, -1], [1, 1, 1])


def strokes_file(path: Path, *photos: str) -> Path:
    """A file with one stroke for the box on each photo, and one for another box."""
    stroke = Stroke(kind=OBJECT, width=4.0, points=np.array([[2.0, 3.0], [5.0, 3.0]]))
    drawn = [Scribble(box="pot", photo=photo, strokes=(stroke,)) for photo in photos]
    other = Scribble(box="cup", photo="a.jpg", strokes=(stroke,))
    path.write_text(scribbles.scribbles_document([*drawn, other]))
    return path


def true_mask(folder: Path, photo: str, pixels: int) -> None:
    """Write a true mask of so many pixels."""
    (folder / "pot").mkdir(exist_ok=True)
    mask = np.arange(100).reshape(10, 10) < pixels
    write_mask(folder / "pot" / f"{photo}.png", mask)


def test_some_photos_may_have_true_masks(tmp_path: Path) -> None:
    true_mask(tmp_path, "b.jpg", 5)
    true_mask(tmp_path, "c.jpg", 50)
    found = scribbles.true_masks(BOX, ["a.jpg", "b.jpg", "c.jpg"], tmp_path)
    assert [(name, mask.sum()) for name, mask in found.items()] == [("c.jpg", 50), ("b.jpg", 5)]


def test_a_persons_strokes_take_the_place_of_simulated_ones(tmp_path: Path) -> None:
    given = Namespace(scribbles=strokes_file(tmp_path / "strokes.json", "a.jpg", "b.jpg"))
    found = scribbles.scribbles_of(given, "pot", {}, 0)
    assert [(each.box, each.photo) for each in found] == [("pot", "a.jpg"), ("pot", "b.jpg")]


def test_objects_are_compared_with_undistorted_photos(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = {"scene": "scene", "images": "elsewhere", "max_side": 96}
    for name, document in (("settings", settings), ("split", {}), ("manifest", {})):
        (tmp_path / f"{name}.json").write_text(json.dumps(document))
    asked: dict[str, Any] = {}

    def loaded(path: Path, **options: Any) -> None:
        asked.update(options, path=path)
        raise KeyboardInterrupt

    monkeypatch.setattr(object_masks, "load_colmap", loaded)
    with pytest.raises(KeyboardInterrupt):
        next(object_masks.views(tmp_path, tmp_path, "pot"))
    assert (asked["path"], asked["images"], asked["max_side"]) == (Path("scene"), "elsewhere", 96)
    assert asked.get("pixels", True)  # without, the masks and photos are the files' own


def test_a_window_story_of_any_scene(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    Image.new("RGB", (30, 40)).save(tmp_path / "images" / "b.jpg")
    file = strokes_file(tmp_path / "strokes.json", "a.jpg", "b.jpg")
    given = Namespace(scribbles=file, box="pot", photo=["c.jpg", "a.jpg"])
    story = window.Story.of(given, tmp_path)
    assert story.photos == ("a.jpg", "b.jpg", "c.jpg")
    assert (story.first.photo, story.correction.photo) == ("a.jpg", "b.jpg")
    assert story.size("b.jpg") == (30, 40)


def test_a_window_story_needs_a_correction(tmp_path: Path) -> None:
    given = Namespace(scribbles=strokes_file(tmp_path / "s.json", "a.jpg"), box="pot", photo=[])
    with pytest.raises(SystemExit, match="two scribbles"):
        window.Story.of(given, tmp_path)


def test_the_demos_story() -> None:
    given = Namespace(scribbles=window.DEMO, box="vase", photo=window.DEMO_PHOTOS)
    story = window.Story.of(given, window.SCENE)
    assert len(story.photos) == 6
    assert all((window.SCENE / "images" / photo).is_file() for photo in story.photos)
