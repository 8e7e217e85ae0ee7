"""The report of an evaluation whose numbers are made by hand."""

from __future__ import annotations

import dataclasses

from roigs_engine.evaluation.report import format_markdown
from roigs_engine.evaluation.scores import (
    Evaluation,
)
from tests.engine.evaluation.tables import by_hand, cells


def test_markdown_table_of_single_photos() -> None:
    text = format_markdown(by_hand())
    table = text.split("Near and far, and single photos:\n\n")[1].split("\n\n")[0].splitlines()
    header, _, base, ours = (cells(line) for line in table)
    assert header[1:] == [
        *("near third (dB)", "near third, object (dB)", "far third (dB)"),
        *("peak gain (dB)", "worst gain (dB)", "photos won"),
    ]
    assert base[1:] == ["20.00", "–", "**20.00**", "–", "–", "–"]
    assert ours[1:] == ["**23.00**", "24.00", "19.50", "+3.00", "-0.50", "75%"]
    assert "on the 1 of 4 photos nearest to the box (1.0 box diagonals from its centre)" in text
    assert "on the 1 farthest (4.0)" in text
    assert "over 'plain'" in text
    assert "Photos of the peak and the worst gain: ours 3.png, 0.png." in text


def test_names_are_no_markdown() -> None:
    name = "<img src=//host/x onerror=a()> ![x](http://host) `a` *b* | _c_ \\"
    scores = by_hand().rois[0]
    rows = (
        scores.rows[0],
        dataclasses.replace(scores.rows[1], model=name, peak_view=name, worst_view=name),
    )
    scores = dataclasses.replace(scores, roi=name, rows=rows)
    text = format_markdown(dataclasses.replace(by_hand(), rois=(scores,)))
    shown = r"\<img src=//host/x onerror=a()\> !\[x\](http://host) \`a\` \*b\* \| \_c\_ \\"
    assert text.count(shown) == 1 + 2 + 3 and "<img" not in text.replace("\\<img", "")


def test_a_report_says_validation_photos() -> None:
    scores = dataclasses.replace(by_hand().rois[0], left_out=("8.png",))
    unseen = dataclasses.replace(scores, roi="unseen", views=(), rows=())
    report = dataclasses.replace(by_hand(), photos="validation", rois=(scores, unseen))
    text = format_markdown(report)
    assert text.count("validation photo") == 3 and "test photo" not in text


def test_a_report_says_what_its_rows_are_made_for_if_they_differ() -> None:
    scores = by_hand().rois[0]
    for names in (("plain", "cycles"), ("viewers", "viewers"), (None, "plain")):
        rows = tuple(
            dataclasses.replace(row, made_for=name)
            for row, name in zip(scores.rows, names, strict=True)
        )
        report = dataclasses.replace(by_hand(), rois=(dataclasses.replace(scores, rows=rows),))
        text = format_markdown(Evaluation.from_dict(report.to_dict()))
        note = "Viewers without Anti-Aliasing: plain; Blender 5.3, Cycles: ours."
        assert (note in text) == (names[0] == "plain")


def test_a_report_of_version_0_1_0_is_read() -> None:
    record = by_hand().to_dict()
    del record["photos"]
    for row in record["rois"][0]["rows"]:
        for name in ("near_psnr", "far_psnr", "roi_flip", "worst_gain", "worst_view", "won_share"):
            del row[name]
        del row["made_for"], row["near_object_psnr"]
        for view in row["views"]:
            del view["distance"], view["roi_flip"]
    old = Evaluation.from_dict(record)
    assert old.rois[0].rows[1].peak_gain == 3.0
    assert old.rois[0].rows[1].near_psnr is None
    text = format_markdown(old)
    assert "near third" not in text and "Near third" not in text
    assert "None" not in text
    assert "peak gain" in text and "worst gain (dB)" not in text
