"""Make Levels: the engine makes them in the run folder, and the result is shown."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.fake_engine import fake
from tests.addon.levels_cases import FAR, make_levels
from tests.addon.scenes import ready

pytestmark = [pytest.mark.blender, pytest.mark.exact_look]

CODE = """
from pathlib import Path
with open("ARGUMENTS", "w") as file:
    json.dump(sys.argv[1:], file)
say(event="stagestarted", stage="levels of vase", total=9)
Path("MADE").rename(Path("RUN") / "levels.json")
say(event="done", outputs={})
"""


@pytest.fixture
def made(blender: ModuleType, run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A scene, its run folder, and the arguments that an engine gets which makes levels."""
    from roigs_addon import settings

    scene, folder = run
    make_levels(folder, rate=FAR)
    (folder / "levels.json").rename(tmp_path / "levels.json")
    names = {"ARGUMENTS": tmp_path / "arguments", "MADE": tmp_path / "levels.json", "RUN": folder}
    code = CODE
    for name, path in names.items():
        code = code.replace(f'"{name}"', repr(str(path)))
    engine = fake(tmp_path, code)
    monkeypatch.setattr(settings, "engine", lambda packages: engine)
    return scene, folder, tmp_path / "arguments"


def test_levels_are_made_and_shown(blender: ModuleType, made) -> None:
    from roigs_addon.jobs import current
    from roigs_addon.scene import ladders

    scene, folder, arguments = made
    assert not ladders.there_are_some(scene)
    assert blender.ops.roigs.make_levels() == {"FINISHED"}
    given = json.loads(arguments.read_text())
    assert given[:2] == ["levels", str(folder)] and "--device" in given
    assert "Background" in scene.objects and ladders.there_are_some(scene)
    assert current.outcome() == "The 3D view and renders now use levels of detail"


def test_a_result_without_a_level_worth_keeping_says_so(blender: ModuleType, made) -> None:
    from roigs_addon.jobs import current
    from roigs_addon.scene import ladders

    scene, folder, _ = made
    make_levels(folder, rate=FAR, farther=())
    (folder / "levels.json").replace(folder.parent / "levels.json")
    assert blender.ops.roigs.make_levels() == {"FINISHED"}
    assert not ladders.there_are_some(scene)
    assert current.outcome().startswith("No level looked good enough")


def test_what_is_shown_already_stays(blender: ModuleType, made) -> None:
    scene, _, _ = made
    blender.ops.roigs.load_results()
    item = scene.objects["thing Gaussians"]
    mesh, item.location = item.data, (1, 2, 3)
    assert blender.ops.roigs.make_levels() == {"FINISHED"}
    assert item.data == mesh and tuple(item.location) == (1, 2, 3)


def test_an_earlier_result_gives_way(blender: ModuleType, two, made) -> None:
    from roigs_addon.scene import compared

    scene, folder, older = two
    blender.ops.roigs.compare_results()
    assert compared.shown_result(scene) == older
    assert blender.ops.roigs.make_levels() == {"FINISHED"}
    assert compared.shown_result(scene) == folder


def test_without_a_result_there_is_nothing_to_do(blender: ModuleType, run) -> None:
    _, folder = run
    for path in (*folder.glob("*.ply"), *folder.glob("rois/*.ply")):
        path.unlink()
    assert not blender.ops.roigs.make_levels.poll()


def test_levels_of_a_training(
    blender: ModuleType, engine: object, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.scene import ladders

    # A few steps more than elsewhere: of a model that has learned nothing, no level is kept. And a
    # strategy without a backdrop, whose large Gaussians would need many more to be learned.
    scene = ready(blender, project, tmp_path / "run", factor=0.02)
    scene.roigs.strategy = "independent"
    blender.ops.roigs.train_roi()
    assert blender.ops.roigs.make_levels() == {"FINISHED"}
    assert ladders.there_are_some(scene) and not ladders.problem(scene)
