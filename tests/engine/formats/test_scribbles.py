"""The file of a person's strokes, and the record of the masks made from them."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roigs_engine.errors import ConfigError, EngineError
from roigs_engine.formats import scribbles
from roigs_engine.formats.files import sha256
from roigs_engine.formats.mask_record import MADE, generated_masks, record_masks, remove_masks
from roigs_engine.formats.scribbles import (
    BACKGROUND,
    read_scribbles,
)

STROKE = {"kind": "object", "width": 4, "points": [[1, 2], [3.5, 4]]}
GOOD = {"box": "vase", "photo": "sub/a.jpg", "strokes": [STROKE]}


def test_strokes_are_read_as_they_were_written(tmp_path: Path) -> None:
    strokes = [STROKE, {"kind": BACKGROUND, "width": 2.5, "points": [[7, 8]]}]
    path = tmp_path / "s.json"
    record = {"scribbles": [{"box": "väse", "photo": "sub/a.jpg", "strokes": strokes}]}
    path.write_text(json.dumps(record, ensure_ascii=False), "utf-8")
    (found,) = read_scribbles(path)
    assert (found.box, found.photo) == ("väse", "sub/a.jpg")
    for mine, theirs in zip(strokes, found.strokes, strict=True):
        assert (mine["kind"], mine["width"]) == (theirs.kind, theirs.width)
        assert np.array_equal(mine["points"], theirs.points)


@pytest.mark.parametrize(
    "document",
    [
        {},
        {"scribbles": []},
        {"scribbles": [7]},
        {"scribbles": [GOOD, GOOD]},
        {"scribbles": [GOOD | {"box": 3}]},
        {"scribbles": [GOOD | {"strokes": []}]},
        {"scribbles": [GOOD | {"strokes": [3]}]},
        *(
            {"scribbles": [GOOD | {"strokes": [STROKE | change]}]}
            for change in (
                {"kind": "vase"},
                {"width": 0},
                {"width": "wide"},
                {"width": float("nan")},
                {"points": []},
                {"points": [[1, 2, 3]]},
                {"points": [[1, 1e9]]},
                {"points": [[1, None]]},
                {"points": "line"},
            )
        ),
    ],
)
def test_a_file_without_strokes_is_refused_in_one_line(tmp_path: Path, document: Any) -> None:
    path = tmp_path / "s.json"
    path.write_text(json.dumps(document))
    with pytest.raises(ConfigError) as error:
        read_scribbles(path)
    assert "\n" not in str(error.value) and error.value.hint


def test_a_file_of_far_too_many_points(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wide strokes of a million points took minutes to draw, without a look at Ctrl-C."""
    monkeypatch.setattr(scribbles, "MOST_POINTS", 5)
    path = tmp_path / "s.json"
    for count, said in ((2, ""), (3, "has 6 points of strokes; at most 5 are used")):
        strokes = [STROKE] * count
        path.write_text(json.dumps({"scribbles": [GOOD | {"strokes": strokes}]}))
        with pytest.raises(ConfigError, match=said) if said else nullcontext():
            read_scribbles(path)


def test_only_masks_that_were_made_are_removed(tmp_path: Path) -> None:
    box = tmp_path / "vase"
    (box / "sub").mkdir(parents=True)
    for name in ("sub/a.jpg.png", "sub/b.jpg.png", "c.jpg.png"):
        (box / name).write_bytes(name.encode())
    made = {name: sha256(box / name) for name in ("sub/a.jpg.png", "sub/b.jpg.png")}
    record_masks(box, made | {"../../x.png": "0"})
    assert generated_masks(box) == made
    (box / "sub/b.jpg.png").write_bytes(b"changed by hand")
    assert generated_masks(box).keys() == {"sub/a.jpg.png"}
    assert remove_masks(box) == 1
    left = {path.relative_to(box).as_posix() for path in box.rglob("*.png")}
    assert left == {"sub/b.jpg.png", "c.jpg.png"} and not (box / MADE).exists()
    assert remove_masks(box) == 0 and remove_masks(tmp_path / "nothing") == 0


def test_a_damaged_record_protects_all_masks(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"x")
    for text in ("", "[]", '{"masks": 3}', '{"masks": {"/etc/passwd": "1", "a.png": 3}}'):
        (tmp_path / MADE).write_text(text)
        assert generated_masks(tmp_path) == {}


def test_a_folder_that_is_a_link_is_not_removed_through(tmp_path: Path) -> None:
    real, box = tmp_path / "real", tmp_path / "box"
    real.mkdir()
    box.mkdir()
    (real / "a.png").write_bytes(b"x")
    (box / "sub").symlink_to(real)
    record_masks(box, {"sub/a.png": sha256(real / "a.png")})
    with pytest.raises(EngineError, match="is a link"):
        remove_masks(box)
    assert (real / "a.png").exists()
