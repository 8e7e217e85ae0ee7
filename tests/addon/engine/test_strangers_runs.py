"""A run folder that somebody else has made: its records are read for panels, whatever they hold."""

from __future__ import annotations

import copy
import json
import random
from pathlib import Path
from typing import Any

import pytest

from roigs_addon.engine import reconstruction, report, run_settings, run_status
from tests.fuzz.damage import tree_damaged
from tests.fuzz.guidance import RECORDS

BOX = {"name": "thing", "world_to_box": [[1.0] * 4] * 4, "half_extents": [0.3] * 3}
SETTINGS = {
    "scene": "garden",
    "images": "photos",
    "max_side": 640,
    "preset": "draft",
    "steps_factor": 2.0,
    "strategy": "joint",
    "exclude": ["a"],
    "count": 3,
    "seed": 1,
    "test_every": 8,
    "made_for": "cycles",
    "method": "coverage",
}
CONFIG = {"scene": {"steps": 2000}, "roi": {"steps": 3000, "made_for": "cycles"}, "max_side": 640}
GOOD: dict[str, Any] = {
    "manifest.json": {
        "config": CONFIG | {"selection": {"method": "coverage", "count": 3}},
        "rois": [BOX],
        "manual": {"thing": ["a"]},
        "contents": {"a": "x"},
    },
    "settings.json": SETTINGS,
    "report.json": RECORDS["report.json"],
    "split.json": RECORDS["split.json"],
    "stages.json": {"scene": "stages/scene-abcdefab"},
    "stages/scene-abcdefab/stage.json": {"seconds": 3.0},
    "reconstruction/state.json": {"done": True},
}


def told(folder: Path) -> list[str]:
    """All that panels say of a run folder's records."""
    now = run_settings.RunSettings.from_options(SETTINGS).of_this_version()
    status, alone = run_status.read(folder), run_settings.read(folder)
    names = run_settings.differing(status.settings, now)
    known = [name for name in run_settings.IN_WORDS if getattr(alone, name) is not None]
    run_settings.work(status.settings)
    reconstruction.read(folder)
    assert sum(status.seconds.values()) >= 0 or status.seconds
    return [
        run_settings.title(status.settings),
        run_settings.in_words(status.settings, names),
        run_settings.in_words(now, names),
        run_settings.in_words(alone, known),
        report.psnr(folder, status.settings.max_side),
        *sorted(status.photos or ()),
    ]


def write(folder: Path, records: dict[str, Any]) -> None:
    for name, tree in records.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(json.dumps(tree).encode("utf-8", "surrogatepass"))


def test_a_good_run_is_told(tmp_path: Path) -> None:
    write(tmp_path, GOOD)
    said = told(tmp_path)
    assert said[0] == "Draft, 640 px, 2 x steps, made for Blender 5.3, Cycles"
    assert said[4].endswith("dB at 640 px on 1 test photo")


@pytest.mark.parametrize("part", range(6))
def test_damaged_records_are_no_errors(tmp_path: Path, part: int) -> None:
    for number in range(100):
        dice = random.Random(f"run {part} {number}")
        names = dice.sample(list(GOOD), dice.choice((1, 1, 2)))
        damaged = {n: tree_damaged(dice, copy.deepcopy(GOOD[n]), most=3) for n in names}
        write(tmp_path, GOOD | damaged)
        assert all(len(text) < 10_000 for text in told(tmp_path)[:5])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("steps_factor", value) for value in ("x", -1, 10**400, float("nan"), [1])),
        *(("max_side", value) for value in ("x", True, 10**400, 1.5)),
        *(("scene", value) for value in (5, True, ["a"], None)),
    ],
)
def test_a_setting_of_another_kind_is_not_known(tmp_path: Path, name: str, value: Any) -> None:
    write(tmp_path, {"settings.json": {"preset": "draft", name: value}})
    found = run_settings.read(tmp_path)
    assert getattr(found, name) == (1.0 if name == "steps_factor" else None)
    assert found.preset == "draft" and run_settings.title(found).startswith("Draft")
