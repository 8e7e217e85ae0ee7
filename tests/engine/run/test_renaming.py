"""A box that gets another name keeps its training."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.context import Context
from roigs_engine.formats.events import Event, Message, StageStarted
from roigs_engine.formats.files import read_json, write_json
from roigs_engine.formats.levels import Ladder, Level, read_ladders, write_ladders
from roigs_engine.model.scene import SfmScene
from roigs_engine.run.renaming import renamed_boxes, with_names
from tests.engine.runs import SECOND, plys, production, train
from tests.engine.synthetic_scene import BOX, make_scene

NAMED = replace(BOX, name="pot")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


@pytest.mark.parametrize("strategy", ["joint", "independent"])
def test_nothing_is_trained_again(scene: SfmScene, tmp_path: Path, strategy: str) -> None:
    config, manual = production(strategy), ["007.png", "002.png", "004.png"]
    train(tmp_path, scene, [BOX, SECOND], config, manual={"thing": manual})
    before = plys(tmp_path)
    events: list[Event] = []
    context = Context(emit=events.append)
    boxes, chosen = [NAMED, SECOND], {"pot": manual}
    train(tmp_path, scene, boxes, config, manual=chosen, update=True, context=context)
    assert not [event for event in events if isinstance(event, StageStarted)]
    said = [event.text for event in events if isinstance(event, Message)]
    assert "Box 'thing' is now called 'pot'; its training is kept." in said
    assert not any("Updated" in text for text in said)
    assert plys(tmp_path) == {name.replace("thing", "pot"): data for name, data in before.items()}
    assert {path.stem for path in (tmp_path / "selection").iterdir()} == {"pot", "second"}
    assert not (tmp_path / "archive").exists()
    assert read_json(tmp_path / "manifest.json")["manual"] == chosen


def test_archived_stages_follow(scene: SfmScene, tmp_path: Path) -> None:
    first, other = production("independent"), production("independent", seed=1)
    train(tmp_path, scene, [BOX], first)
    train(tmp_path, scene, [BOX], other, update=True)
    events: list[Event] = []
    train(tmp_path, scene, [NAMED], other, update=True)
    train(tmp_path, scene, [NAMED], first, update=True, context=Context(emit=events.append))
    assert not [event for event in events if isinstance(event, StageStarted)]
    assert (tmp_path / "rois" / "pot.ply").is_file() and not (
        tmp_path / "rois" / "thing.ply"
    ).exists()


def test_levels_of_detail_follow(scene: SfmScene, tmp_path: Path) -> None:
    train(tmp_path, scene, [BOX], production("joint"))
    files = ("rois/thing.ply", "levels/1/rois/thing.ply")
    (tmp_path / "levels/1/rois").mkdir(parents=True)
    (tmp_path / files[1]).write_bytes((tmp_path / files[0]).read_bytes())
    levels = [
        Level(ply=ply, gaussians=9, farther=farther, measured={})
        for ply, farther in zip(files, (0.0, 2.0), strict=True)
    ]
    probes = np.zeros((1, 3))
    write_ladders(
        tmp_path, [Ladder(box="thing", rate=9.0, probes=probes, levels=tuple(levels))], {}
    )
    write_json(tmp_path / "levels/made.json", {files[1]: "5"})
    train(tmp_path, scene, [NAMED], production("joint"), update=True)
    ladder = read_ladders(tmp_path)["pot"]
    assert [level.ply for level in ladder.levels] == ["rois/pot.ply", "levels/1/rois/pot.ply"]
    assert all((tmp_path / level.ply).is_file() for level in ladder.levels)
    assert read_json(tmp_path / "levels/made.json") == {"levels/1/rois/pot.ply": "5"}


def manifest(**boxes: float) -> dict:
    return {"rois": [{"name": name, "half_extents": [size]} for name, size in boxes.items()]}


def test_boxes_are_found_by_their_place() -> None:
    assert renamed_boxes(manifest(a=1, b=2), manifest(a=1, b=2)) == {}
    assert renamed_boxes(manifest(a=1, b=2), manifest(c=1, b=2)) == {"a": "c"}
    assert renamed_boxes(manifest(a=1), manifest(b=2)) == {}
    chain = renamed_boxes(manifest(a=1, b=2), manifest(b=1, c=2))
    assert list(chain.items()) == [("b", "c"), ("a", "b")]
    assert renamed_boxes(manifest(a=1, b=2, c=3), manifest(b=1, a=2, d=3)) == {"c": "d"}
    assert renamed_boxes(manifest(a=1, b=1), manifest(c=1, d=1)) == {}, "which is which?"
    assert renamed_boxes({"rois": [7, {"name": 3}]}, manifest(a=1)) == {}
    assert renamed_boxes("damaged", manifest(a=1)) == {}


def test_a_damaged_manifest_is_no_error() -> None:
    damaged = {"rois": [{"name": "a"}, 7, {}], "manual": 3}
    assert with_names(damaged, {"a": "b"}) == {"rois": [{"name": "b"}, {"name": None}], "manual": 3}
