"""What the panel learns of a run folder, and of names."""

from __future__ import annotations

import functools
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

from roigs_addon.engine import runs
from tests.addon.scenes import add_box, imported

HOLD = """
import sys
from pathlib import Path
from roigs_engine.lock import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def write(path: Path, text: str = "{}") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def test_a_run_is_read_from_its_folder(tmp_path: Path) -> None:
    assert runs.read(tmp_path / "none") == runs.Run()
    write(tmp_path / "scene" / "stage.json")
    write(tmp_path / "object-vase" / "checkpoint.bin")
    box = {"name": "vase", "world_to_box": [[1]], "half_extents": [1]}
    write(tmp_path / "request.json", json.dumps({"rois": [box]}))
    run = runs.read(tmp_path)
    assert run.done == ("scene",) and run.left == "object-vase" and not run.result
    assert run.boxes == {"vase": ([[1]], [1])}
    assert runs.stage_in_words(run.left) == "box «vase»"
    write(tmp_path / "request.json", "no JSON")
    assert runs.read(tmp_path).boxes is None


def test_an_engine_at_work_is_told_from_a_lock_that_was_left(tmp_path: Path) -> None:
    write(tmp_path / "run.lock", '{"pid": 1}')
    assert runs.read(tmp_path).holder == 0
    root = Path(__file__).parents[2]
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, tmp_path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=root,
    ) as engine:
        assert engine.stdout is not None and engine.stdin is not None
        assert engine.stdout.readline() == "held\n"
        assert runs.read(tmp_path).holder == engine.pid
        engine.stdin.close()
    assert runs.read(tmp_path).holder == 0


def test_the_panel_says_which_boxes_have_changed(
    blender: ModuleType, addon: ModuleType, project: Path, tmp_path: Path
) -> None:
    from roigs_addon import facts, regions

    scene = imported(blender, project)
    scene.roigs.run_dir = str(tmp_path)
    roi = add_box(blender, "vase", (-1, -1, -1), (1, 1, 1))
    blender.context.view_layer.update()
    trained = runs.Run(boxes={"vase": tuple(list(regions.to_dict(roi, scene).values())[1:])})
    assert facts.changed(scene, trained) == []
    scene.roigs.root.location.x += 3
    blender.context.view_layer.update()
    assert facts.changed(scene, trained) == []
    roi.location.x += 0.1
    blender.context.view_layer.update()
    assert facts.changed(scene, trained) == ["vase"]
    assert facts.changed(scene, runs.Run()) == ["vase"]


def test_photos_are_shown_without_folders_where_that_is_clear(
    blender: ModuleType, addon: ModuleType
) -> None:
    from roigs_addon.facts import _shorter

    names = ["a/1.jpg", "b/1.jpg", "b/deep/2.png", "3.jpg"]
    assert list(_shorter(names).values()) == ["a/1.jpg", "b/1.jpg", "2", "3"]


def test_a_large_model_is_counted_in_a_thread(
    blender: ModuleType, addon: ModuleType, project: Path, monkeypatch
) -> None:
    from roigs_addon import counts

    scene = imported(blender, project)
    roi = add_box(blender, "vase", (-1, -1, -1), (1, 1, 1))
    blender.context.view_layer.update()
    monkeypatch.setattr(counts, "LARGE", 1)
    first = counts.count_soon(roi, scene)
    assert first == counts.count(roi, scene)
    roi.location.x += 100
    blender.context.view_layer.update()
    assert counts.count_soon(roi, scene) == first, "the last one, until the new one is there"
    while not counts._counter.idle():
        pass
    assert counts.count_soon(roi, scene) == (0, 0)


def test_an_engine_that_lacked_something_is_asked_afresh(
    blender: ModuleType, addon: ModuleType, monkeypatch
) -> None:
    from roigs_addon import facts
    from roigs_addon.engine import python

    missing = [("torch",), ()]
    fresh = functools.lru_cache(lambda _: python.Ability(version=(3, 12), missing=missing.pop(0)))
    monkeypatch.setattr(python, "ability", fresh)
    monkeypatch.setattr(facts, "ENGINE_SECONDS", 0.0)
    engine = facts._EngineCheck()
    for expected in ("torch", ""):
        engine.ask()
        engine.thread.join()
        assert expected in engine.problem and bool(expected) == bool(engine.problem)
