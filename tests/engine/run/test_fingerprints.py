"""Fingerprints of stages: the same for the same work, others where something decides it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PosedImage, SfmScene
from roigs_engine.requests.choices import COMPARISONS
from roigs_engine.run.config import RunConfig
from roigs_engine.run.definition import define_run
from roigs_engine.run.presets import preset
from roigs_engine.run.strategies import plan_run

CAMERA = Camera(width=64, height=48, fx=64.0, fy=64.0, cx=32.0, cy=24.0)
TURNS = [np.linalg.matrix_power(np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]]), k) for k in range(4)]


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
        OrientedBox.between("vase", [-2.25, -1, -1], [-0.75, 1, 1]),
        OrientedBox.between("tin", [0.75, -1, -1], [2.25, 1, 1]),
    ]


def fingerprints(folder: Path, scene: SfmScene, config: RunConfig) -> dict[str, str]:
    run = define_run(folder, scene, boxes(), replace(config, test_every=4))
    return {stage.name: stage.fingerprint for stage in plan_run(run, COMPARISONS).stages}


@pytest.mark.parametrize("name", ["draft", "paper"])
def test_the_same_plan_has_the_same_fingerprints(tmp_path: Path, name: str) -> None:
    config = preset(name)
    found = fingerprints(tmp_path, exact_scene(), config)
    assert found == fingerprints(tmp_path / "other", exact_scene(), config)
    alike = {"full-object-vase", "full-object-tin", "full-scene"}  # the same photos see both
    assert len({found[stage] for stage in alike}) == 1


def test_what_photos_observe_decides(tmp_path: Path) -> None:
    """Background points, floaters and the measured SH rate go by it."""
    scene = exact_scene()
    fewer = tuple(replace(image, point_indices=image.point_indices[1:]) for image in scene.images)
    one, other = (
        fingerprints(tmp_path, each, preset("draft"))
        for each in (scene, replace(scene, images=fewer))
    )
    assert not set(one.values()) & set(other.values())


def test_the_order_of_mechanisms_decides(tmp_path: Path) -> None:
    draft = preset("draft")
    turned = replace(draft.scene, mechanisms=draft.scene.mechanisms[::-1])
    one, other = (
        fingerprints(tmp_path, exact_scene(), config)
        for config in (draft, replace(draft, scene=turned))
    )
    assert one["scene"] != other["scene"]
