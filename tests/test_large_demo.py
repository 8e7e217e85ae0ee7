"""The large demo's benchmark: which views it measures on, from where, and its table."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.large_demo import held_out_photos, lines
from roigs_engine.evaluation.scores import Evaluation, ModelScore, RoiScores


@pytest.fixture
def large(tmp_path: Path) -> Path:
    turn = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    known = {"centre": [1.0, 2.0, 3.0], "rotation": turn}
    names = ("held_out/ring/0.jpg", "held_out/ring/1.jpg", "ring/0.jpg")
    truth = {"width": 64, "height": 40, "focal": 50.0, "photos": dict.fromkeys(names, known)}
    (tmp_path / "truth.json").write_text(json.dumps(truth))
    for folder in ("images_held_out", "even_held_out"):
        (tmp_path / folder / "ring").mkdir(parents=True)
    Image.new("RGB", (64, 40)).save(tmp_path / "images_held_out/ring/0.png")
    return tmp_path


def test_views_are_those_that_are_rendered_from_the_true_places(large: Path) -> None:
    (view,) = held_out_photos(large, "images", 32)
    assert view.name == "held_out/ring/0.jpg" and view.path.suffix == ".png"
    assert (view.camera.width, view.camera.height, view.camera.fx) == (32, 20, 25.0)
    camera_to_world = np.linalg.inv(view.world_to_camera)
    assert camera_to_world[:3, 3] == pytest.approx([1.0, 2.0, 3.0])
    assert camera_to_world[:3, 2] == pytest.approx([1.0, 0.0, 0.0])  # looks along +x
    assert held_out_photos(large, "even", 32) == []


def test_the_table_has_a_row_for_each_box_and_run() -> None:
    row = ModelScore(
        model="levelled",
        roi_psnr=25.0,
        object_psnr=None,
        roi_ssim=0.91234,
        image_psnr=24.5,
        gaussians=1234,
        gaussians_in_box=1,
        seconds=0.0,
        stages={},
        ply_bytes=1,
        views=(),
        image_views={},
        corrected_psnr=26.0,
    )
    scores = RoiScores(roi="vase", views=(), left_out=(), object_mask_from=None, rows=(row,))
    evaluation = Evaluation(test_views=(), baseline="levelled", rois=(scores,))
    (line,) = lines(evaluation)
    assert line == ["vase", "levelled", "25.00", "26.00", "", "0.912", "24.50", "1,234"]
