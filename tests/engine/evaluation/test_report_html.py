"""The report's page: what it holds, and its sliders in a browser."""

from __future__ import annotations

import dataclasses
import io
import re
import time
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
from PIL import Image

from roigs_engine.evaluation.crops import Comparison, Shown, comparisons
from roigs_engine.evaluation.evaluate import evaluate
from roigs_engine.evaluation.report_html import format_html, write_page
from roigs_engine.evaluation.scores import Evaluation
from tests import chromium
from tests.chromium import browser
from tests.engine.evaluation.tables import by_hand
from tests.engine.evaluation.two_models import TEST, two_models
from tests.engine.synthetic_scene import BOX, make_scene

NASTY = "</style><script>document.title='broken'</script>\"' onload=\"alert(1)"
VOID = {"meta", "img", "input", "br", "path", "circle"}


class Shape(HTMLParser):
    """Counts elements, and checks that those that open close."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.counts: dict[str, int] = {}
        self.attributes: set[str] = set()
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.counts[tag] = self.counts.get(tag, 0) + 1
        self.attributes |= {name for name, _ in attrs}
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.counts[tag] = self.counts.get(tag, 0) + 1

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def jpeg(colour: tuple[int, int, int]) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (200, 100), colour).save(out, "JPEG", quality=95)
    return out.getvalue()


def comparison(name: str = "box") -> Comparison:
    shown = (
        Shown(name="photo", psnr=None, jpeg=jpeg((0, 0, 255))),
        Shown(name=name, psnr=20.0, jpeg=jpeg((255, 0, 0))),
        Shown(name="ours", psnr=23.0, jpeg=jpeg((0, 255, 0))),
    )
    return Comparison(roi=name, view="3.png", label="largest gain", size=(200, 100), pictures=shown)


def named(name: str) -> Evaluation:
    """The report by hand, with box and baseline of that name."""
    report = by_hand()
    (scores,) = report.rois
    rows = (dataclasses.replace(scores.rows[0], model=name, seconds=10.0), *scores.rows[1:])
    return dataclasses.replace(
        report, rois=(dataclasses.replace(scores, roi=name, rows=rows),), baseline=name
    )


def test_all_is_there() -> None:
    text = format_html(by_hand(), [comparison()])
    shape = Shape(text)
    assert shape.counts["table"] == 2 and shape.counts["img"] == 3
    assert "<strong>23.00</strong>" in text and "Gaussians" in text and "in box" in text
    assert "ours: 23.00 dB" in text
    assert not re.search("https?://(?!www.w3.org)", text)


def test_names_stay_text() -> None:
    shape = Shape(format_html(named(NASTY), [comparison(NASTY)]))
    assert shape.counts["script"] == 1
    assert "onload" not in shape.attributes


def test_seconds_are_drawn_if_they_are_known() -> None:
    report = by_hand()
    (scores,) = report.rois
    assert all(row.seconds > 0 for row in scores.rows)
    assert Shape(format_html(report, [])).counts["circle"] == 2
    rows = tuple(dataclasses.replace(row, seconds=0.0) for row in scores.rows)
    unknown = dataclasses.replace(report, rois=(dataclasses.replace(scores, rows=rows),))
    assert "<svg" not in format_html(unknown, [])


def test_a_box_without_scores_has_its_note() -> None:
    scores = dataclasses.replace(by_hand().rois[0], views=(), rows=())
    text = format_html(dataclasses.replace(by_hand(), rois=(scores,)), [])
    assert "No test photo shows this box" in text
    Shape(text)


def test_pictures_of_an_evaluation(tmp_path: Path) -> None:
    scene = make_scene(tmp_path, views=5)
    models = two_models()
    report = evaluate(models, scene, TEST, [BOX])
    found = comparisons(report, models, scene, [BOX])
    assert [shown.name for shown in found[0].pictures] == ["photo", "Full Scene", "Ours"]
    for item in found:
        opened = [Image.open(io.BytesIO(shown.jpeg)) for shown in item.pictures]
        assert {picture.size for picture in opened} == {item.size}
    lost = found[0].view
    scene.image(lost).path.unlink()
    left = comparisons(report, models, scene, [BOX])
    assert [item.view for item in left] == [item.view for item in found[1:]]


@browser
def test_a_table_fits_into_a_window(tmp_path: Path) -> None:
    path = write_page(named("Full Scene, tuned"), [], tmp_path)
    with chromium.Page(path, width=1280, height=900) as shown:
        time.sleep(1)
        wide = "[...document.querySelectorAll('.wide')].map(e => e.scrollWidth - e.clientWidth)"
        assert max(shown.run(wide)) <= 0


@browser
def test_the_slider_shows_both_sides(tmp_path: Path) -> None:
    path = write_page(named(NASTY), [comparison(NASTY)], tmp_path)
    with chromium.Page(path, width=900, height=900) as shown:
        time.sleep(1)
        assert shown.run("document.title").startswith("Evaluation on")
        left, top, width, height = shown.run(
            "(() => { const r = document.querySelector('.slider').getBoundingClientRect();"
            " return [r.left, r.top, r.width, r.height]; })()"
        )
        assert (width, height) == (200, 100)

        def colours() -> tuple[np.ndarray, np.ndarray]:
            row = shown.picture()[int(top + height / 2)]
            return row[int(left + 50)].astype(int), row[int(left + 150)].astype(int)

        before, after = colours()
        assert before[0] > 200 > before[1] and after[1] > 200 > after[0]
        shown.click(left + 190, top + 50)
        time.sleep(0.3)
        assert colours()[1][0] > 200
        assert not shown.problems
