"""Requests: checked as they are made, and the words that they share with the engine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roigs_engine import (
    Convert,
    Evaluate,
    Select,
    Train,
    TrainAndEvaluate,
    plan_training,
    train,
)
from roigs_engine.commands.table import COMMANDS
from roigs_engine.errors import ConfigError
from roigs_engine.requests import choices
from roigs_engine.requests.declare import options_of, settings_of
from roigs_engine.run.presets import PRESETS
from roigs_engine.selection import METHODS
from tests.engine.synthetic_colmap import write_project


def test_plain_values_become_those_of_the_fields() -> None:
    given: dict[str, Any] = {"scene": "garden", "roi": ["auto"], "max_side": 640.0}
    request = Select(**given)
    assert (request.scene, request.roi, request.max_side) == (Path("garden"), ("auto",), 640)
    assert settings_of(request) == {
        "scene": str(Path("garden").absolute()),
        "roi": ["auto"],
        "max_side": 640,
    }


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"count": 0}, "'count': 0 is not an integer from 1"),
        ({"method": "best"}, "'method': 'best' is not one of"),
        ({"no_masks": 1}, "'no_masks': 1 is not true or false"),
        ({"max_side": 9, "downscale": 2.0}, "both 'downscale' and 'max_side'"),
        ({"scene": None}, "has no 'scene'"),
        ({"scene": Path("a\0b")}, "'scene': .* is not a string"),
        ({"no_masks": 0}, "'no_masks': 0 is not true or false"),
    ],
)
def test_values_that_do_not_fit(values: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        Select(**{"scene": Path("garden"), **values})


def test_numbers_and_arrays_of_numpy_are_those_of_python() -> None:
    given: dict[str, Any] = {
        "roi": np.array(["auto"]),
        "seed": np.int64(3),
        "downscale": np.float32(2),
        "no_masks": np.bool_(True),
    }
    request = Select(scene=Path("garden"), **given)
    assert request == Select(
        scene=Path("garden"), roi=("auto",), seed=3, downscale=2.0, no_masks=True
    )


def test_none_is_no_value() -> None:
    given: dict[str, Any] = {"roi": None, "exclude": None, "preset": None, "update": None}
    request = Train(scene=Path("garden"), run_dir=Path("run"), **given)
    assert request == Train(scene=Path("garden"), run_dir=Path("run"))


def test_what_must_be_given_is_not_empty() -> None:
    with pytest.raises(ConfigError, match="has no 'model'"):
        Evaluate(scene=Path("garden"), out=Path("out"), model=())


def test_a_training_is_not_started_by_a_plan(tmp_path: Path) -> None:
    scene = write_project(tmp_path / "scene", names=[f"{k}.png" for k in range(8)], dots=True)
    box = "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5"
    run = tmp_path / "run"
    request = Train(scene=scene.folder, roi=(box,), run_dir=run, steps_factor=0.003, dry_run=True)
    with pytest.raises(ConfigError, match="plan_training"):
        train(request)
    assert "Box 'thing'" in plan_training(request).text and not run.exists()


def test_methods_and_presets_are_those_of_the_engine() -> None:
    assert set(choices.METHODS) == set(METHODS) and set(choices.PRESETS) == set(PRESETS)


def test_each_option_has_one_kind_wherever_it_is() -> None:
    """A word means one thing: options of one name take the same values, but for their range."""
    kinds: dict[str, set[type]] = {}
    for command in COMMANDS.values():
        for name, option in options_of(command.request).items():
            kinds.setdefault(name, set()).add(type(option.kind))
    different = {name for name, found in kinds.items() if len(found) > 1}
    assert different <= {"run_dir", "levels", "model"}, different
    assert set(options_of(Train)) < set(options_of(TrainAndEvaluate))
    assert options_of(Convert)["page_scene"].flags == ("--scene",)
