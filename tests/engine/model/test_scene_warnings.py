"""Warnings about scenes and boxes that train badly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.context import Context
from roigs_engine.formats.events import Event, Message
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import SfmScene
from roigs_engine.model.scene_checks import FEW, few_photos, scene_warnings
from roigs_engine.run.config import RunConfig
from roigs_engine.run.stages import PhotoSets
from tests.engine.runs import opened, tiny
from tests.engine.synthetic_scene import BOX, make_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"), views=6)


def test_a_sound_scene_needs_none(scene: SfmScene) -> None:
    assert scene_warnings(scene, [BOX]) == []


def test_a_box_inside_another(scene: SfmScene) -> None:
    inner = OrientedBox.between("inner", [-0.3] * 3, [0.3] * 3)
    points = np.array([[0.1, 0.1, 0.1], [0.5, 0.5, 0.5]])
    both = replace(scene, points=points)
    (line,) = scene_warnings(both, [inner, BOX])
    assert "'inner' owns none of its 1 points" in line and "--only inner" in line
    assert scene_warnings(both, [inner]) == []


def test_a_run_says_so(scene: SfmScene, tmp_path: Path) -> None:
    inner = OrientedBox.between("inner", [-0.55] * 3, [0.55] * 3)
    heard: list[Event] = []
    opened(tmp_path, scene, [inner, BOX], tiny("joint"), context=Context(emit=heard.append))
    texts = [e.text for e in heard if isinstance(e, Message) and e.level == "warning"]
    assert [text for text in texts if "'inner' owns none" in text]


def test_too_few_photos() -> None:
    for count, words in {0: "No photo sees", 1: "Only one photo", FEW - 1: "Add photos"}.items():
        (line,) = few_photos("vase", count)
        assert words in line and "'vase'" in line
    assert few_photos("vase", FEW) == few_photos("vase", FEW, tests=3) == []


def test_test_photos_are_not_counted_but_named() -> None:
    (one,) = few_photos("vase", 1, tests=2)
    assert "one training photo sees box 'vase' (2 of the 3 that see it are test photos):" in one
    (two,) = few_photos("vase", 2, tests=1)
    assert "2 training photos see box 'vase' (1 of the 3 that see it is a test photo):" in two


@pytest.mark.parametrize("tracks", [True, False])
def test_a_run_and_a_selection_count_test_photos_apart(
    scene: SfmScene, tmp_path: Path, tracks: bool
) -> None:
    scene = replace(scene, has_tracks=tracks)
    few = scene.select([image.name for image in scene.images[:3]])
    run = opened(tmp_path, few, [BOX], tiny("joint"))
    (flag,) = [f for f in PhotoSets(run).selection(run.rois[0]).flags if "Only" in f]
    assert f"Only 2 training photos see box '{BOX.name}' (1 of the 3 that see it is a" in flag
    run = opened(tmp_path / "all", scene, [BOX], asking_for_many())
    (flag,) = [f for f in PhotoSets(run).selection(run.rois[0]).flags if "Only" in f]
    assert f"see box '{BOX.name}' (1 of the 6 that see it is a test photo), fewer than" in flag


def asking_for_many() -> RunConfig:
    config = tiny("joint")
    return replace(config, selection=replace(config.selection, count=99))
