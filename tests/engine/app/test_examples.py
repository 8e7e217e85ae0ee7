"""The examples run, one after the other, on a small scene."""

from __future__ import annotations

import json
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

import roigs_engine
from roigs_engine.formats.splat_ply import check_ply
from tests.engine.synthetic_colmap import write_project

EXAMPLES = Path(roigs_engine.__file__).parents[1] / "examples"
MOST_LINES = 30
TINY: dict[str, Any] = {"steps_factor": 0.003, "device": "cpu"}


def example(name: str) -> Any:
    """The function `main` of an example."""
    spec = spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.main


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    names = [f"{k}.png" for k in range(10)]
    folder = write_project(tmp_path_factory.mktemp("examples") / "scene", names=names, dots=True)
    box = {"name": "thing", "min": [-0.5] * 3, "max": [0.5] * 3}
    (folder.folder / "rois.json").write_text(json.dumps({"rois": [box]}), encoding="utf-8")
    return folder.folder


def test_a_box_is_trained(scene: Path, tmp_path: Path) -> None:
    check_ply(example("train_box")(scene, tmp_path / "run", **TINY))


def test_own_photos_are_trained_on_and_the_result_measured(scene: Path, tmp_path: Path) -> None:
    rois, run = scene / "rois.json", tmp_path / "run"
    check_ply(example("own_photos")(scene, rois, run, test_every=4, **TINY))
    manifest = json.loads((run / "manifest.json").read_text(encoding="utf-8"))
    assert len(manifest["manual"]["thing"]) > 0
    table = example("evaluate_and_convert")(scene, rois, run, tmp_path / "out", device="cpu")
    assert "Scene-GS" in table and (tmp_path / "out" / "result.glb").exists()


def test_they_are_short() -> None:
    for path in EXAMPLES.glob("*.py"):
        assert len(path.read_text(encoding="utf-8").splitlines()) <= MOST_LINES, path
