"""Stages keep their fingerprints: runs of earlier versions resume, and finished stages are used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage, SfmScene
from roigs_engine.run.config import COMPARISONS
from roigs_engine.run.definition import define_run
from roigs_engine.run.presets import preset
from roigs_engine.run.strategies import plan_run

CAMERA = Camera(width=64, height=48, fx=64.0, fy=64.0, cx=32.0, cy=24.0)
TURNS = [np.linalg.matrix_power(np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]]), k) for k in range(4)]
RECORDED = {
    "draft": {
        "scene": "fecdf281",
        "joint": "5a27e5c1",
        "compare-independent/scene": "bb801c16",
        "compare-independent/object-vase": "ee8606ea",
        "compare-independent/object-tin": "e9e01d89",
        "compare-independent/refine": "06c743f8",
        "full-scene": "34aab47b",
        "tuned-scene": "518ca5ed",
        "full-object-vase": "34aab47b",
        "full-object-tin": "34aab47b",
        "tuned-object-vase": "ebe21953",
        "tuned-object-tin": "0f0aaf4c",
    },
    "paper": {
        "scene": "951aabe0",
        "object-vase": "1b128121",
        "object-tin": "0d914ac2",
        "compare-joint/scene": "b3c92c8c",
        "compare-joint/joint": "3134f352",
        "full-scene": "0f27950c",
        "tuned-coarse-scene": "b3c92c8c",
        "tuned-scene": "67ed997e",
        "full-object-vase": "0f27950c",
        "full-object-tin": "0f27950c",
        "tuned-object-vase": "2112b470",
        "tuned-object-tin": "09a341fd",
    },
}


def exact_scene() -> SfmScene:
    """Photos and points at positions that every machine computes alike."""
    grid = np.arange(-2.0, 3.0)
    points = np.stack(np.meshgrid(grid, grid / 2, grid, indexing="ij"), axis=-1).reshape(-1, 3)
    images = []
    for k in range(12):
        pose = np.eye(4)
        pose[:3, :3] = TURNS[k % 4]
        pose[:3, 3] = [k // 4 - 1, 0.25 * (k % 2), 8]
        images.append(
            PosedImage(
                name=f"{k:02d}.png",
                path=Path(f"{k:02d}.png"),
                camera=CAMERA,
                world_to_camera=pose,
                point_indices=np.arange(k % 3, len(points), 2),
                digest=str(k),
            )
        )
    colors = (points * 40 + 128).astype(np.uint8)
    return SfmScene(images=tuple(images), points=points, colors=colors)


def boxes() -> list[OrientedBox]:
    """Two boxes that the same photos see."""
    return [
        OrientedBox.axis_aligned("vase", [-2.25, -1, -1], [-0.75, 1, 1]),
        OrientedBox.axis_aligned("tin", [0.75, -1, -1], [2.25, 1, 1]),
    ]


@pytest.mark.parametrize("name", ["draft", "paper"])
def test_stages_keep_their_fingerprints(tmp_path: Path, name: str) -> None:
    config = replace(preset(name), test_every=4)
    run = define_run(tmp_path, exact_scene(), boxes(), config)
    found = {stage.name: stage.fingerprint[:8] for stage in plan_run(run, COMPARISONS).stages}
    assert found == RECORDED[name]


def test_what_photos_observe_decides_the_backdrop(tmp_path: Path) -> None:
    scene = exact_scene()
    fewer = tuple(replace(image, point_indices=image.point_indices[1:]) for image in scene.images)
    found = {}
    for cells in (0, 16):
        config = replace(preset("draft"), test_every=4)
        config = replace(config, scene=replace(config.scene, backdrop_cells=cells))
        found[cells] = [
            plan_run(define_run(tmp_path, each, boxes(), config)).stages[0].fingerprint
            for each in (scene, replace(scene, images=fewer))
        ]
    assert found[0][0] == found[0][1] and found[16][0] != found[16][1]
