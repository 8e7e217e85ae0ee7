"""The study's rows: which there are, in which order, variants of them; numbers over seeds."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.study import measure, work
from benchmarks.study.results import Stat, mean_of
from benchmarks.study.rows import all_rows, changed, parse_variant, wanted
from benchmarks.study.scenes import StudyScene
from roigs_engine.errors import ConfigError
from roigs_engine.requests.choices import MAX_FACTOR
from roigs_engine.run.presets import preset
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.mechanisms.model_averaging import ModelAveraging


def test_main_rows_of_the_first_seed_come_first() -> None:
    rows = wanted(all_rows("draft"), ["I", "II", "III"], [])
    scenes = [StudyScene(name=name, path=Path(name), rois=[]) for name in "ab"]
    order = [(s.name, seed, row.name) for s, seed, row in work.in_order(rows, scenes, [7, 8])]
    assert len(order) == len(set(order)) == len(rows) * 4
    main = ["full-scene", "full-scene-tuned", "matched-tuned", "joint"]
    assert order[:8] == [(scene, 7, row) for scene in "ab" for row in main]
    assert order[8:16] == [(scene, 8, row) for scene in "ab" for row in main]
    assert order[16] == ("a", 7, "full-object")
    assert order.index(("b", 7, "gp6-48")) < order.index(("a", 7, "gp6-20"))


def test_the_factor_of_equal_time_has_two_digits() -> None:
    found = [measure.equal_time_factor(theirs, 10.0) for theirs in (20.0, 21.74, 123.4, 4.567)]
    assert found == [2.0, 2.2, 12.0, 0.46]
    assert measure.equal_time_factor(1.0, 0.0) == MAX_FACTOR


def test_equal_time_lengthens_the_box_stage_alone() -> None:
    draft = preset("draft")
    longer = measure.longer_box_stage(draft, 1.5)
    assert longer.scene == draft.scene
    assert (longer.roi.steps, longer.roi.of(DensityControl).until) == (4500, 1000)
    assert longer.roi.of(ModelAveraging).steps == 450
    assert measure.longer_box_stage(draft, 0.1).roi.of(DensityControl).until == 100


def test_many_photos_are_rows_of_the_main_ways_only() -> None:
    rows = {row.name: row for row in all_rows("paper")}
    many = [name for name in rows if name.endswith(("-70", "-100"))]
    assert sorted(many) == ["independent-100", "independent-70", "joint-100", "joint-70"]
    chosen = [
        rows[name].config("paper", 1.0, 0).selection.resolved_count(314)
        for name in ("independent-20", "independent", "independent-70", "independent-100")
    ]
    assert chosen == [63, 150, 220, 314]
    assert all("III" in rows[name].tables for name in many)


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("roi.steps=3", "has no name"),
        ("joint:roi.steps=3", "is a row of the tables"),
        ("a:roi.step=3", "There is no setting"),
        ("a:roi.steps=many", "cannot be 'many'"),
        ("a:seed=3", "cannot set"),
        ("a:roi.steps=9999", "the baselines for 5000"),
        ("a:roi", "cannot set"),
        ("a:roi=3", "cannot be"),
    ],
)
def test_variants_that_cannot_be(text: str, wrong: str) -> None:
    with pytest.raises(ConfigError, match=wrong):
        parse_variant(text, "draft")


def test_a_variant_sets_fields_and_takes_shares_along() -> None:
    row = parse_variant(
        "a-1:scene.steps=1000,roi.steps=3600,selection.count=9,roi_order=ordered", "draft"
    )
    config, own = row.config("draft", 0.5, seed=4), preset("draft")
    assert (config.scene.steps, config.roi.steps, config.seed) == (500, 1800, 4)
    until = {name: getattr(own, name).of(DensityControl).until for name in ("scene", "roi")}
    assert config.scene.of(DensityControl).until == round(until["scene"] / 4)
    assert config.roi.of(DensityControl).until == round(until["roi"] * 0.6)
    assert (config.selection.count, config.selection.seed, config.roi_order) == (9, 4, "ordered")
    assert changed(own, []) == own


def test_patterns_pick_rows() -> None:
    rows = all_rows("paper")
    names = [row.name for row in wanted(rows, [], ["gp6-*", "joint"])]
    assert names == ["joint", "gp6-48", "gp6-40", "gp6-20"]
    with pytest.raises(ConfigError, match="No row is named 'gp7'"):
        wanted(rows, [], ["gp7"])


def test_numbers_over_seeds() -> None:
    stat = Stat({0: 1.0, 1: 3.0})
    assert stat.text("+.2f") == "+2.00 ± 1.41"
    assert Stat({2: 1.0}).text(".1f") == "1.0 †"
    assert Stat().text(".1f") == "-"
    assert stat.minus(Stat({1: 0.5, 2: 9.0})).values == {1: 2.5}
    assert mean_of([stat, Stat({1: 5.0})]).values == {1: 4.0}
    assert mean_of([stat, Stat()]).values == {}
