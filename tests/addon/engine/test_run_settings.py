"""The settings of a training, compared and in words."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from roigs_addon.engine import report, run_settings
from roigs_addon.engine.run_settings import IN_WORDS, RunSettings
from roigs_addon.engine.training_steps import PRESET_STEPS
from roigs_engine.run.presets import in_strategy, preset

OPTIONS = {"scene": "/a/garden", "preset": "draft", "max_side": 640, "seed": 1, "count": 8}


def test_every_setting_has_words() -> None:
    settings = RunSettings.from_options(OPTIONS)
    assert set(IN_WORDS) == set(vars(settings)) - {"steps"}
    assert run_settings.in_words(settings, ["preset", "max_side", "count", "exclude"]) == (
        "Draft, 640 px, 8 photos a box, all photos"
    )
    assert run_settings.title(settings) == "Draft, 640 px"
    assert run_settings.title(RunSettings()) == ""


def test_only_what_is_known_differs() -> None:
    then = RunSettings.from_options(OPTIONS)
    assert run_settings.differing(RunSettings(), then) == []
    moved = RunSettings.from_options(OPTIONS | {"scene": "/b/garden"})
    assert run_settings.differing(then, moved) == []
    other = {"seed": 2, "exclude": ["b", "a"], "steps_factor": 0.5, "scene": "/a/refined"}
    now = RunSettings.from_options(OPTIONS | other)
    assert run_settings.differing(then, now) == ["steps_factor", "seed", "exclude", "scene"]


STANDARD = OPTIONS | {"preset": "standard", "strategy": "joint"}


def test_a_preset_of_an_earlier_version_differs() -> None:
    stages, steps = {"scene": {"steps": 6000}, "roi": {"steps": 9000}}, 15_000
    then = RunSettings.from_options(STANDARD, stages)
    now = RunSettings.from_options(STANDARD).of_this_version()
    assert run_settings.differing(then, now) == ["recipe"]
    before, after = run_settings.work(then), run_settings.work(now)
    assert before and after and before / after == pytest.approx(steps / 8500)
    other = RunSettings.from_options(OPTIONS | {"strategy": "joint"}).of_this_version()
    assert run_settings.differing(then, other) == ["preset"]


@pytest.mark.parametrize("factor", [1, 0.5, 0.001])
@pytest.mark.parametrize("strategy", ["joint", "independent"])
@pytest.mark.parametrize("name", sorted(PRESET_STEPS))
def test_the_engines_presets_are_of_this_version(name: str, strategy: str, factor: float) -> None:
    config = in_strategy(preset(name), strategy).scaled(factor).to_dict()
    options = OPTIONS | {"preset": name, "strategy": strategy, "steps_factor": factor}
    then = RunSettings.from_options(options, config)
    assert run_settings.differing(then, RunSettings.from_options(options).of_this_version()) == []
    assert then.steps and then.recipe == run_settings.THIS


@pytest.mark.parametrize("steps", ["x", True, 0, -3, 10**400, None, [1]])
@pytest.mark.parametrize("factor", [float("inf"), float("nan"), 1e308, "a", -1, 0])
def test_odd_records_say_nothing_of_steps(steps: Any, factor: Any) -> None:
    config = {"scene": {"steps": 4000}, "roi": {"steps": steps}, "steps": 7}
    then = RunSettings.from_options(STANDARD | {"steps": "abc", "steps_factor": factor}, config)
    assert then.steps is None and then.recipe is None
    run_settings.work(then)
    assert "recipe" not in run_settings.differing(then, then.of_this_version())


def test_what_the_options_leave_out_is_in_the_manifest(tmp_path: Path) -> None:
    config = {"preset": "paper", "scene": {}, "strategy": "independent", "seed": 0}
    config |= {"selection": {"method": "gp9", "count": None, "seed": 3}, "test_every": 8}
    found = run_settings.read(tmp_path, config)
    assert (found.method, found.strategy, found.test_every) == ("gp9", "independent", 8)
    assert found.max_side is None and found.scene is None and found.count == 0
    assert found.made_for is None
    assert run_settings.read(tmp_path, config | {"roi": {}}).made_for is None
    assert (
        run_settings.read(tmp_path, config | {"roi": {"made_for": "cycles"}}).made_for == "cycles"
    )
    (tmp_path / "settings.json").write_text(json.dumps(OPTIONS))
    found = run_settings.read(tmp_path, config)
    assert (found.scene, found.method, found.seed, found.count) == ("garden", "gp9", 1, 8)
    (tmp_path / "settings.json").write_text("[]")
    assert run_settings.read(tmp_path) == RunSettings()


@pytest.mark.parametrize(
    ("record", "expected"),
    [
        ({"rois": [{"rows": [{"roi_psnr": 20}, {"roi_psnr": 25}]}, {"rows": [{"roi_psnr": 26}]}],
          "test_views": ["a"], "photos": "validation"}, "25.5 dB on 1 validation photo"),
        ({"rois": [{"rows": [{"roi_psnr": None}]}], "test_views": []}, ""),
        ({"rois": [{"rows": []}], "test_views": []}, ""),
        ({"rois": 3}, ""),
        ([], ""),
    ],
)  # fmt: skip
def test_psnr(tmp_path: Path, record: object, expected: str) -> None:
    assert report.psnr(tmp_path) == ""
    (tmp_path / "report.json").write_text(json.dumps(record))
    assert report.psnr(tmp_path) == expected
