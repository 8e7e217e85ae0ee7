"""A result does not depend on a scene's units, origin, or one misplaced camera."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.evaluation.evaluate import evaluate
from roigs_engine.formats import run_files
from roigs_engine.formats.splat_ply import read_ply
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import SfmScene
from roigs_engine.rasterize.view import render_view
from roigs_engine.run.config import RunConfig
from roigs_engine.run.definition import define_run
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.mechanisms.importance_pruning import ImportancePruning
from roigs_engine.training.mechanisms.warm_restarts import WarmRestarts
from tests.engine.runs import tiny, train_run
from tests.engine.settings import without
from tests.engine.synthetic_scene import make_scene
from tests.engine.units import in_units

# Askew, so that no two photos show it alike: rounding would choose between them.
COS, SIN = np.cos(0.4), np.sin(0.4)
BOX = OrientedBox(
    name="askew",
    world_to_box=np.array([[COS, SIN, 0, 0.02], [-SIN, COS, 0, -0.01], [0, 0, 1, 0], [0, 0, 0, 1]]),
    half_extents=np.array([0.6, 0.5, 0.55]),
)


def settled(strategy: str) -> RunConfig:
    """A short run without densification, which makes of a rounding error another model."""
    config = tiny(strategy)
    kinds = DensityControl, WarmRestarts, ImportancePruning
    scene, roi = (without(stage, *kinds) for stage in (config.scene, config.roi))
    return replace(config, scene=scene, roi=roi)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


def trained_psnr(folder: Path, scene: SfmScene, box: OrientedBox, strategy: str) -> float:
    """PSNR in the box's silhouette on the test photos, dB, after a short run."""
    run = define_run(folder, scene, [box], settled(strategy))
    models = train_run(run)
    psnr = evaluate(models, run.scene, run.test, run.rois).rois[0].rows[-1].roi_psnr
    assert psnr is not None
    return psnr


@pytest.fixture(scope="module")
def usual(scene: SfmScene, tmp_path_factory: pytest.TempPathFactory) -> dict[str, float]:
    return {
        strategy: trained_psnr(tmp_path_factory.mktemp(strategy), scene, BOX, strategy)
        for strategy in ("joint", "independent")
    }


@pytest.mark.parametrize(
    ("scale", "shift"),
    [(1e-6, 0.0), (1e-3, 0.0), (1e6, 0.0), (1.0, 1e6), (1e-3, 1e6), (25.4, -1e6)],
)
def test_units_and_origin_do_not_matter(
    scene: SfmScene, usual: dict[str, float], tmp_path: Path, scale: float, shift: float
) -> None:
    moved, box = in_units(scene, BOX, scale, shift)
    assert trained_psnr(tmp_path, moved, box, "joint") == pytest.approx(usual["joint"], abs=0.1)
    # The result is in the user's frame.
    means = read_ply(tmp_path / run_files.RESULT)["means"]
    inside = box.contains(means.astype(np.float64))
    assert inside.any()
    fine = read_ply(tmp_path / run_files.FINE / f"{box.name}.ply")["means"]
    assert len(fine) == inside.sum()


def test_the_strategy_with_a_stage_for_each_box(
    scene: SfmScene, usual: dict[str, float], tmp_path: Path
) -> None:
    moved, box = in_units(scene, BOX, 1e-3, 1e6)
    psnr = trained_psnr(tmp_path, moved, box, "independent")
    assert psnr == pytest.approx(usual["independent"], abs=0.1)


def test_selected_photos_have_distances_in_the_users_unit(scene: SfmScene, tmp_path: Path) -> None:
    small, box = in_units(scene, BOX, 0.01, 0.0)
    found = []
    for folder, photos, roi in ((tmp_path / "a", scene, BOX), (tmp_path / "b", small, box)):
        train_run(define_run(folder, photos, [roi], settled("joint")))
        text = (folder / "selection" / f"{roi.name}.json").read_text(encoding="utf-8")
        features = json.loads(text)["features"]
        found.append([features[name]["distance"] for name in sorted(features)])
    np.testing.assert_allclose(found[1], 0.01 * np.array(found[0]), rtol=1e-6)


def test_a_file_in_millimetres_is_drawn_the_same(scene: SfmScene, tmp_path: Path) -> None:
    train_run(define_run(tmp_path, scene, [BOX], settled("joint")))
    image = scene.images[0]
    model, frame = Gaussians.load_framed(tmp_path / run_files.RESULT)
    wanted = render_view(model, image.camera, frame.transform(image.world_to_camera)).image
    assert wanted.std() > 0.05  # a picture of something
    moved, box = in_units(scene, BOX, 1e-4, 300.0)
    train_run(define_run(tmp_path / "moved", moved, [box], settled("joint")))
    image = moved.images[0]
    model, frame = Gaussians.load_framed(tmp_path / "moved" / run_files.RESULT)
    drawn = render_view(model, image.camera, frame.transform(image.world_to_camera)).image
    assert float((drawn - wanted).abs().mean()) < 0.01
