"""Baselines of the study alone: in one stage, and with our number of Gaussians."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.study.baselines import matched, one_stage, one_stage_config
from roigs_engine.run import stage_configs
from roigs_engine.run.definition import define_run
from roigs_engine.run.plan import POINTS
from roigs_engine.run.presets import PRESETS, preset
from roigs_engine.run.stages import PhotoSets
from roigs_engine.run.strategies import full_scene_tuned
from roigs_engine.training.mechanisms.background_points import BackgroundPoints
from roigs_engine.training.mechanisms.box_density_control import BoxDensityControl
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.mechanisms.model_averaging import ModelAveraging
from tests.engine.runs import tiny
from tests.engine.synthetic_scene import BOX, make_scene


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_in_one_stage_they_begin_like_3dgs(name: str) -> None:
    config = preset(name)
    one, plain = one_stage_config(config), stage_configs.baseline(config)
    assert (one.steps, one.sh_start) == (plain.steps, plain.sh_start)
    density, usual = (each.of(DensityControl) for each in (one, plain))
    assert density == replace(usual, reset_every=0, every=density.every)
    two = stage_configs.tuned_baseline(config).fine
    average = one.of(ModelAveraging)
    assert average.steps == config.total_steps // 10
    first, *others = one.mechanisms
    assert isinstance(first, BackgroundPoints)
    alike = two.using(density, average)
    assert tuple(others) == alike.mechanisms
    assert one == replace(
        two, steps=plain.steps, sh_start=plain.sh_start, mechanisms=one.mechanisms
    )


@pytest.mark.parametrize("name", ["joint", "independent"])
def test_they_differ_from_the_tuned_one_in_little(tmp_path: Path, name: str) -> None:
    photos = PhotoSets(define_run(Path("nowhere"), make_scene(tmp_path), [BOX], tiny(name)))
    tuned, one = full_scene_tuned(photos).stages[-1], one_stage(photos).stages[-1]
    stage = matched(photos, (7,), tuned=True).stages[-1]
    assert len({tuned.fingerprint, one.fingerprint, stage.fingerprint}) == 3
    assert one.start.kind == POINTS and (one.name, stage.name) == ("tuned-scene", "tuned-matched")
    threshold = photos.run.config.roi.of(DensityControl).grad_threshold / 4
    boxes, usual = stage.config.of(BoxDensityControl), tuned.config.of(DensityControl)
    assert (boxes.grad_threshold, boxes.outside_threshold) == (threshold, usual.grad_threshold)
    assert not boxes.box_sizes and boxes.budgets == (7,)
    assert stage.config == tuned.config.using(boxes) and stage.rois == photos.run.rois
    assert stage.start.fingerprint == tuned.start.fingerprint
