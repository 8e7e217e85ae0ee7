"""Adapt: the engine trains the result for another renderer; it is shown beside the trained one."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from roigs_engine.formats.splat_ply import read_ply, target_of, write_ply
from roigs_engine.formats.targets import CYCLES, VIEWERS
from tests.addon.fake_engine import fake
from tests.addon.panels import said
from tests.addon.splat_cases import random_arrays

pytestmark = pytest.mark.blender

CODE = """
import shutil
with open(ARGUMENTS, "w") as file:
    json.dump(sys.argv[1:], file)
shutil.copyfile(ADAPTED, sys.argv[sys.argv.index("--out") + 1])
say(event="done", outputs={})
"""
PARTS = {"background.ply": slice(1, 40, 2), "rois/thing.ply": slice(0, 40, 2)}
"""Rows of the whole: parts are mixed in it."""


@pytest.fixture
def made(blender: ModuleType, run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A scene with a shown result, its run folder, what an engine gets, and what it makes."""
    from roigs_addon import settings

    scene, folder = run
    whole = random_arrays(40, seed=0)
    write_ply(folder / "result.ply", whole, VIEWERS)
    for name, rows in PARTS.items():
        write_ply(folder / name, {key: values[rows] for key, values in whole.items()}, VIEWERS)
    (folder / "settings.json").write_text(json.dumps({"preset": "draft", "max_side": 320}))
    adapted = whole | {"means": whole["means"] + 1, "logit_opacities": np.arange(40, dtype="f4")}
    write_ply(tmp_path / "adapted.ply", adapted, CYCLES)
    names = {"ARGUMENTS": tmp_path / "arguments", "ADAPTED": tmp_path / "adapted.ply"}
    code = CODE
    for name, path in names.items():
        code = code.replace(name, repr(str(path)))
    engine = fake(tmp_path, code)
    monkeypatch.setattr(settings, "engine", lambda packages: engine)
    blender.ops.roigs.load_results()
    return scene, folder, names["ARGUMENTS"], adapted


@pytest.mark.exact_look
def test_the_result_is_adapted_and_shown(blender: ModuleType, made) -> None:
    from roigs_addon.jobs import current
    from roigs_addon.scene import compared, made_for
    from roigs_addon.ui.result import ResultPanel

    scene, folder, arguments, adapted = made
    scene.roigs.made_for = "viewers"
    assert not made_for.mismatch(scene)
    scene.roigs.made_for = "cycles"
    told = said(blender, ResultPanel)
    assert "Adapt to Blender 5.3, Cycles" in told and "Made for Splat" in " ".join(told)
    assert blender.ops.roigs.adapt_result(made_for="cycles") == {"FINISHED"}
    given = json.loads(arguments.read_text())
    assert given[:4] == ["adapt", str(folder / "result.ply"), "--scene", scene.roigs.colmap]
    assert given[4:8] == ["--max-side", "320", "--made-for", "cycles"]
    place = folder / "earlier" / "adapted-cycles"
    assert compared.shown_result(scene) == place and not made_for.mismatch(scene)
    for name, rows in PARTS.items():
        part = read_ply(place / name)
        assert target_of(place / name) == CYCLES
        np.testing.assert_array_equal(part["logit_opacities"], adapted["logit_opacities"][rows])
    assert current.outcome().startswith("Adapted to Blender 5.3, Cycles")
    assert not (folder / "blender" / "adapted.ply").exists()
    told = " ".join(said(blender, ResultPanel))
    assert "Adapt to" not in told and "Draft, 320 px, made for Blender" in told
    blender.ops.roigs.load_results()
    assert compared.shown_result(scene) == folder and made_for.mismatch(scene)


def test_nothing_is_written_through_links(blender: ModuleType, made, tmp_path: Path) -> None:
    _, folder, _, _ = made
    mine, first = tmp_path / "mine", folder / "coarse" / "thing.ply"
    mine.write_text("mine")
    place = folder / "earlier" / "adapted-cycles" / "coarse" / "thing.ply"
    place.parent.mkdir(parents=True)
    place.symlink_to(mine)
    assert blender.ops.roigs.adapt_result(made_for="cycles") == {"FINISHED"}
    assert mine.read_text() == "mine"
    assert not place.is_symlink() and place.read_bytes() == first.read_bytes()


def test_a_result_that_was_changed_is_not_cut(blender: ModuleType, made) -> None:
    _, folder, _, _ = made
    write_ply(folder / "rois" / "thing.ply", random_arrays(20, seed=5), VIEWERS)
    with pytest.raises(RuntimeError, match=r"thing.ply is not a part of result.ply. Train again."):
        blender.ops.roigs.adapt_result(made_for="cycles")
    assert not (folder / "earlier" / "adapted-cycles" / "result.ply").exists()


@pytest.mark.exact_look
def test_what_is_drawn_in_another_light_is_named(blender: ModuleType, made, tmp_path: Path) -> None:
    from roigs_addon.scene import made_for, splats
    from roigs_addon.ui.result import ResultPanel

    scene, *_ = made
    assert made_for.in_other_light(scene) is None
    path = tmp_path / "other.ply"
    write_ply(path, random_arrays(5, seed=9), CYCLES)
    splats.show_imported(scene, path, "other", in_model=True)
    assert made_for.in_other_light(scene) == ("other", CYCLES)
    told = " ".join(said(blender, ResultPanel))
    assert "'other' is made for Blender 5.3, Cycles, but drawn like the others" in told
