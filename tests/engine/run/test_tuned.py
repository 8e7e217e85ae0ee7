"""The tuned baselines: all settings of ours that fit any scene, and nothing that needs boxes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from roigs_engine.evaluation.evaluate import evaluate
from roigs_engine.formats.run_files import is_own
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import SfmScene
from roigs_engine.requests.choices import BASELINES
from roigs_engine.run import stage_configs
from roigs_engine.run.config import RunConfig
from roigs_engine.run.definition import define_run
from roigs_engine.run.plan import Plan, Stage
from roigs_engine.run.presets import PRESETS, preset
from roigs_engine.run.stages import PhotoSets
from roigs_engine.run.strategies import plan_run
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.mechanisms.floater_pruning import FloaterPruning
from roigs_engine.training.mechanisms.importance_pruning import ImportancePruning
from roigs_engine.training.mechanisms.measured_sh_rate import MeasuredShRate
from roigs_engine.training.mechanisms.model_averaging import ModelAveraging
from roigs_engine.training.mechanisms.opacity_decay import OpacityDecay
from roigs_engine.training.mechanisms.warm_restarts import WarmRestarts
from tests.engine.runs import tiny, train, train_run
from tests.engine.synthetic_scene import BOX, make_scene

TUNED = ("full-scene-tuned", "full-object-tuned")
SECOND = OrientedBox.between("second", [-0.2, -0.2, -0.2], [0.5, 0.5, 0.5])
# Mechanisms that fit any scene.
USED = (
    *(MeasuredShRate, DensityControl, WarmRestarts, ModelAveraging),
    *(OpacityDecay, ImportancePruning, FloaterPruning),
)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


def planned(
    scene: SfmScene, config: RunConfig, *boxes: OrientedBox, compare: tuple[str, ...] = TUNED
) -> Plan:
    return plan_run(define_run(Path("nowhere"), scene, boxes or [BOX], config), compare)


def by_name(plan: Plan) -> dict[str, Stage]:
    return {stage.name: stage for stage in plan.stages}


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_settings_are_ours_without_the_boxes(name: str) -> None:
    config = preset(name)
    tuned, plain = stage_configs.tuned_baseline(config), stage_configs.baseline(config)
    assert tuned.scale == 0.5
    coarse, fine = tuned.coarse, tuned.fine
    assert coarse.steps + fine.steps == plain.steps == config.total_steps
    assert tuple(type(each) for each in fine.mechanisms) == USED
    first, last, usual = (each.of(DensityControl) for each in (coarse, fine, plain))
    assert first.reset_every == last.reset_every == 0
    assert last.grad_threshold == 2e-4
    assert plain.made_for == "plain" and plain.mechanisms == (usual,)  # 3DGS's way
    assert coarse.made_for == fine.made_for == config.roi.made_for
    ours = preset("standard").roi
    for field in ("lr_shN", "lr_scales", "lr_means", "sh_start"):
        assert getattr(fine, field) == getattr(ours, field)
    for kind in (MeasuredShRate, OpacityDecay, FloaterPruning):
        assert fine.of(kind) == ours.of(kind)
    assert fine.of(ModelAveraging).steps == fine.steps // 10
    densify = first.until + last.until
    assert densify == max(usual.until, first.until + fine.steps // 3)
    if name != "paper":
        assert coarse == config.scene
        assert densify == config.total_steps // 2


def test_all_photos_whole_shuffled_and_everywhere(scene: SfmScene) -> None:
    config = tiny("joint", scene_scale=0.5)
    run = define_run(Path("nowhere"), scene, [BOX, SECOND], config)
    stages = by_name(plan_run(run, TUNED))
    tuned, joint = stages["tuned-scene"], stages["joint"]
    assert tuned.images == joint.images == run.train_scene.images
    assert tuned.order.kind == "shuffled" and tuned.order.count == len(tuned.images)
    assert (tuned.seed, tuned.extent) == (joint.seed, joint.extent)
    assert [roi.name for roi in tuned.rois] == [roi.name for roi in joint.rois]
    assert tuned.config.lr_shN == joint.config.lr_shN
    assert type(tuned.config.of(DensityControl)) is DensityControl


def test_the_first_stage_is_the_runs_own_where_it_is_the_same(scene: SfmScene) -> None:
    config = tiny("joint", scene_scale=0.5)
    names = list(by_name(planned(scene, config, compare=("full-scene", "full-scene-tuned"))))
    assert names == ["scene", "joint", "full-scene", "tuned-scene"]
    reserving = by_name(planned(scene, replace(config, kept_share=0.5)))
    first, own = reserving["tuned-coarse-scene"], reserving["scene"]
    assert first.config == own.config and len(own.images) < len(first.images)
    assert reserving["tuned-scene"].start.inputs == (first,)
    independent = by_name(planned(scene, tiny("independent")))
    first, own = independent["tuned-coarse-scene"], independent["scene"]
    assert first.images[0].camera.width == own.images[0].camera.width // 2
    assert first.config.steps == own.config.steps == config.scene.steps


def test_full_object_sees_the_photos_of_its_box(scene: SfmScene) -> None:
    run = define_run(Path("nowhere"), scene, [BOX, SECOND], tiny("joint"))
    plan = plan_run(run, ["full-object", "full-object-tuned"])
    stages, photos = by_name(plan), PhotoSets(run)
    for roi in run.rois:
        tuned = stages[f"tuned-object-{roi.name}"]
        assert tuned.images == stages[f"full-object-{roi.name}"].images == photos.seen(roi)
        assert [box.name for box in tuned.rois] == [roi.name]
    names = [model.name for model in plan.models]
    assert names[:4] == [*["Full Object"] * 2, *["Full Object, tuned"] * 2]


def test_rows_and_times_of_a_run(scene: SfmScene, tmp_path: Path) -> None:
    """The shared stage is trained once and counts for both."""
    config = tiny("joint", scene_scale=0.5)
    models = train(tmp_path, scene, [BOX], config, BASELINES)
    seconds = {model.name: model.stages for model in models}
    assert list(seconds) == [
        *("Full Scene", "Full Scene, tuned", "Full Object", "Full Object, tuned"),
        *("Scene-GS (joint)", "Joint"),
    ]
    assert set(seconds["Full Scene, tuned"]) == {"scene", "tuned-scene"}
    assert seconds["Full Scene, tuned"]["scene"] == seconds["Joint"]["scene"] > 0
    assert "tuned-object-thing" in seconds["Full Object, tuned"]
    assert len(seconds["Full Object, tuned"]) == 2
    assert [model.rois for model in models if "Object" in model.name] == [("thing",)] * 2
    assert all(is_own(path.name) for path in tmp_path.iterdir())
    run = define_run(tmp_path, scene, [BOX], config)
    for rows, baseline in ((models, "Full Scene, tuned"), (models[:1], "Full Scene")):
        report = evaluate(rows, run.scene, run.measured, run.rois)
        gains = {row.model: row.peak_gain for row in report.roi("thing").rows}
        assert report.baseline == baseline and gains[baseline] is None
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("stage.json")}
    train_run(run, BASELINES)
    assert before == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("stage.json")}
