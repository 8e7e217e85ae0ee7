"""Messages about matches and results."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from roigs_engine.formats.text import plain_text
from roigs_engine.reconstruction.mapping import Mapped
from roigs_engine.reconstruction.photo_checks import Found, Photo, unread_in_words, warnings_of
from roigs_engine.reconstruction.report import (
    Reconstruction,
    as_markdown,
    connected,
    findings,
    reason,
    warnings_of_matches,
)

NAMES = [f"{letter}.jpg" for letter in "abcdefgh"]


def photo(name: str) -> Photo:
    return Photo(name=name, path=Path(name), digest=name, size=(640, 480), device="", sharpness=1.0)


def model(names: str, points: int = 500) -> Mapped:
    photos = {f"{letter}.jpg": points for letter in names}
    return Mapped(folder="", photos=photos, points=900, error=0.5, track=3.0)


def result(**changes: object) -> Reconstruction:
    """All photos registered, but for the changes."""
    pairs = {(one, other): 90 for one in NAMES for other in NAMES if one < other}
    usual = Reconstruction(
        found=Found(photos=tuple(map(photo, NAMES)), unreadable=(), copies={}),
        features=dict.fromkeys(NAMES, 3000),
        matched=pairs,
        models=[model("abcdefgh")],
        seconds={"features": 3.0},
    )
    return replace(usual, **changes)


def test_all_is_well() -> None:
    told = findings(result())
    assert told == [
        ("info", "8 of 8 photos registered, 900 points, reprojection error 0.50 px."),
    ]
    assert "Not registered" not in as_markdown(result())


def test_photos_of_two_places_are_named_before_they_are_placed() -> None:
    pairs = {("a.jpg", "b.jpg"): 90, ("b.jpg", "c.jpg"): 20, ("d.jpg", "e.jpg"): 40}
    pairs |= {("e.jpg", "f.jpg"): 40, ("c.jpg", "d.jpg"): 9}
    assert connected(NAMES, pairs)[:2] == [NAMES[:3], NAMES[3:6]]
    (text,) = warnings_of_matches(NAMES, pairs, {2: 4})
    assert "2 unconnected places" in text and "a.jpg, b.jpg and 1 more" in text


@pytest.mark.parametrize(
    ("kinds", "said"),
    [
        ({5: 9, 6: 9, 2: 1}, "from one place"),
        ({6: 702, 3: 588}, ""),
        ({7: 9, 2: 2}, "turntable"),
        ({2: 9, 7: 2}, ""),
    ],
)
def test_what_all_pairs_have_in_common_is_said(kinds: dict[int, int], said: str) -> None:
    texts = warnings_of_matches(NAMES, result().matched, kinds)
    assert said in " ".join(texts) and bool(texts) == bool(said)


def test_a_turntable_is_told_of_masks_in_the_panels_words_and_the_commands() -> None:
    (said,) = warnings_of_matches(["a", "b"], {}, {7: 3})
    assert "Masks" in said and "--masks" in said


def test_each_missing_photo_has_a_reason() -> None:
    matched = {pair: 90 for pair in result().matched if set("defgh") & set("".join(pair)) == set()}
    few = result(
        models=[model("abc"), model("fg")],
        features={**dict.fromkeys(NAMES, 3000), "d.jpg": 50, "e.jpg": 0},
        matched={**matched, ("f.jpg", "g.jpg"): 60, ("c.jpg", "h.jpg"): 17},
    )
    told = {name: reason(few, name) for name in few.missing}
    assert told["d.jpg"] == "few features (50)"
    assert told["e.jpg"].startswith("no features")
    assert told["f.jpg"] == "in model 2, which is not connected with the largest"
    assert told["h.jpg"] == "too few matches: 1 photo, at best 17 with c.jpg"
    assert all(f"| {name} | {why} |" in as_markdown(few) for name, why in told.items())
    assert findings(few)[1][0] == "warning"


def test_weak_results_are_warned_of() -> None:
    two = result(models=[model("ab", points=40)])
    texts = [text for level, text in findings(two) if level == "warning"]
    assert any("Only two photos" in text for text in texts)
    assert any("fewer than 100 points" in text for text in texts)
    two = result(models=[replace(model("abcdefgh"), error=2.5)])
    assert any("error is high: 2.5 px" in text for _, text in findings(two))


def test_without_a_model_there_is_a_report() -> None:
    text = as_markdown(result(models=[], matched={}))
    assert "No two photos could be registered" in text
    assert text.count("| no photo matches it |") == 8


def test_photos_that_hang_on_few_points_are_named() -> None:
    """24 of 24 may be registered, one of them by a single point."""
    best = model("abcdefgh")
    best.photos.update({"b.jpg": 29, "c.jpg": 1, "d.jpg": 30})
    told = findings(result(models=[best]))
    (text,) = (text for level, text in told if level == "warning")
    assert text.startswith("2 photos have fewer than 30 points and may be registered wrongly")
    assert "c.jpg, b.jpg." in text
    report = as_markdown(result(models=[best]))
    assert text not in report  # the panel has buttons for them
    assert "| c.jpg | 1 |" in report


def test_names_are_no_markdown_and_no_html() -> None:
    name = "[a](javascript:b) | <img src=x> `_*\n# c.jpg"
    found = Found(photos=(*result().found.photos, photo(name)), unreadable=(name,), copies={})
    weak = model("ab")
    weak.photos[f"{name}d"] = 40
    report = as_markdown(result(found=found, features={name: 9}, models=[weak]))
    escaped = r"\[a\](javascript:b) \| \<img src=x\> \`\_\* # c.jpg"
    assert report.count(escaped) >= 3 and f"| {escaped} |" in report
    assert not re.search(r"(?<!\\)[`*_\[\]<>]|\n# c", report)
    assert plain_text(escaped) == " ".join(name.split())


def test_formats_that_are_not_read_are_counted() -> None:
    assert unread_in_words({}) == []
    assert unread_in_words({".DNG": 1}) == ["1 .DNG file was not read: export it as JPEG."]
    text = "3 .CR2, 12 .NEF files were not read: export them as JPEG."
    found = Found(
        photos=result().found.photos, unreadable=(), copies={}, unread={".NEF": 12, ".CR2": 3}
    )
    assert warnings_of(found) == [text]
    assert f"- {text}" in as_markdown(result(found=found))
