"""Estimate: the engine says how long a training would take; the panel shows it."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.panels import said
from tests.addon.scenes import ready, status

pytestmark = pytest.mark.blender


def test_steps_and_minutes(
    blender: ModuleType, addon: ModuleType, engine: object, project: Path, tmp_path: Path
) -> None:
    from roigs_addon.jobs import estimate_job
    from roigs_addon.ui.train import TrainPanel

    bpy, scene = blender, ready(blender, project, tmp_path / "run")
    assert "Up to 24 steps" in said(bpy, TrainPanel)
    scene.roigs.steps_factor = 1.0
    assert "Up to 6,000 steps" in said(bpy, TrainPanel)
    assert bpy.ops.roigs.estimate_time() == {"FINISHED"}
    time = estimate_job.known(scene)
    assert time.startswith("about ") and "thread" in time
    shown = " ".join(said(bpy, TrainPanel))
    assert "Up to 6,000 steps, about" in shown
    assert not status(scene).done and not status(scene).unfinished
    scene.roigs.preset = "standard"  # the time is of other settings
    assert estimate_job.known(scene) == "" and "Up to 10,000 steps" in said(bpy, TrainPanel)
    scene.roigs.preset = "draft"
    assert estimate_job.known(scene) == time
    scene.roigs.active_roi.scale.x *= 2
    bpy.context.view_layer.update()
    assert estimate_job.known(scene) == ""
