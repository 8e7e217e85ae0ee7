"""The scene of a run: whether its model is still the one that the run was trained with."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from roigs_engine.app.run_scene import cameras_of_run, warn_of_other_model
from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import QUIET, Context
from roigs_engine.formats.events import Event, Message
from tests.engine.synthetic_colmap import camera, write_project

NAMES = ["a.png", "b.png", "c.png", "d.png"]
SIZES = [camera(), camera(width=41, height=67)]


def trained(folder: Path, **options: float) -> tuple[Path, Path]:
    """A scene, and a folder that says what a run of these photos says of it."""
    scene = write_project(folder / "scene", names=NAMES, cameras=SIZES).folder
    found = load_colmap(scene, pixels=False, **options)  # type: ignore[arg-type]
    run = folder / "run"
    run.mkdir()
    manifest = {
        "config": {},
        "contents": {image.name: "" for image in found.images},
        "sizes": [f"{image.camera.width}x{image.camera.height}" for image in found.images],
        "model": found.digest()[:16],
    }
    (run / "manifest.json").write_text(json.dumps(manifest))
    (run / "settings.json").write_text(json.dumps({"scene": str(scene), **options}))
    return scene, run


def warned(run: Path, scene: Path) -> bool:
    said: list[Event] = []
    warn_of_other_model(run, scene, None, Context(emit=said.append))
    assert all(isinstance(each, Message) and each.level == "warning" for each in said)
    return bool(said)


@pytest.mark.parametrize("options", [{}, {"max_side": 50}, {"downscale": 1.7}], ids=str)
def test_the_model_of_the_training(options: dict[str, float], tmp_path: Path) -> None:
    scene, run = trained(tmp_path, **options)
    assert not warned(run, scene)


def more_photos(scene: Path) -> None:
    """A photo that the run has not used, as it was damaged then."""
    manifest = scene.parent / "run/manifest.json"
    record = json.loads(manifest.read_text())
    kept = load_colmap(scene, pixels=False).without(["b.png"])
    del record["contents"]["b.png"]
    manifest.write_text(json.dumps(record | {"model": kept.digest()[:16]}))


def turned(scene: Path) -> None:
    """The same photos in another frame, as of another reconstruction."""
    model = pycolmap.Reconstruction(str(scene / "sparse/0"))
    rotation = pycolmap.Rotation3d(np.array([0, 0.3, 0, 0.954]))
    model.transform(pycolmap.Sim3d(1.3, rotation, np.array([0.2, 0.0, 0.1])))
    model.write(str(scene / "sparse/0"))


def unknown(scene: Path) -> None:
    """The folder's record is of no use."""
    (scene.parent / "run/manifest.json").write_text('{"contents": [], "model": 7}')


@pytest.mark.parametrize(
    ("change", "said"), [(more_photos, False), (turned, True), (unknown, False)]
)
def test_another_model(change: Callable[[Path], None], said: bool, tmp_path: Path) -> None:
    scene, run = trained(tmp_path)
    change(scene)
    assert warned(run, scene) == said


def test_the_cameras_of_a_run_are_those_of_its_photos(tmp_path: Path) -> None:
    """Not of excluded ones: levels made by `train` would be made again."""
    scene, run = trained(tmp_path)
    more_photos(scene)
    found = cameras_of_run(run, None, QUIET)
    assert [image.name for image in found.images] == [n for n in NAMES if n != "b.png"]
