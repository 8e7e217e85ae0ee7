"""The tuned baselines: all settings of ours that fit any scene, and nothing that needs boxes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from roigs_engine.training.densification import DensityInputs, density_control
from roigs_engine.training.densification.adaptive import AdaptiveDensity

from roigs_engine.evaluation.evaluate import evaluate
from roigs_engine.formats.run_files import is_own
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import SfmScene
from roigs_engine.run import stage_configs
from roigs_engine.run.baselines import full_scene_tuned, matched_tuned
from roigs_engine.run.config import BASELINES, RunConfig
from roigs_engine.run.definition import define_run
from roigs_engine.run.folder import train_run
from roigs_engine.run.photo_sets import PhotoSets
from roigs_engine.run.plan import POINTS, Plan, Stage
from roigs_engine.run.presets import PRESETS, preset
from roigs_engine.run.strategies import plan_run, strategy
from tests.engine.runs import tiny, train
from tests.engine.synthetic_scene import BOX, make_scene

TUNED = ("full-scene-tuned", "full-object-tuned")
SECOND = OrientedBox.axis_aligned("second", [-0.2, -0.2, -0.2], [0.5, 0.5, 0.5])
# What boxes bring to the box stage, as 3DGS has it.
PLAIN = {
    "densify_in_boxes": False,
    "box_budget": 0.0,
    "box_grad_threshold": 0.0,
    "full_every": 1,
    "outside_spared_spread": 0.0,
    "outside_rate": 0.0,
    "view_weighting": 0.0,
    "contribution_every": 0,
    "reset_every": 0,
}


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
    tuned, plain = stage_configs.tuned_baseline(config, True), stage_configs.baseline(config)
    assert tuned.coarse is not None and tuned.scale == 0.5
    coarse, fine = tuned.coarse, tuned.fine
    assert coarse.steps + fine.steps == plain.steps == config.total_steps
    assert {field: getattr(fine, field) for field in PLAIN} == PLAIN
    assert coarse.reset_every == 0
    assert fine.grad_threshold == 2e-4
    assert not plain.antialiased and not plain.restarts  # 3DGS's way
    assert coarse.antialiased == fine.antialiased == config.roi.antialiased
    ours = preset("standard").roi
    for field in ("lr_shN", "lr_shN_spacing", "lr_scales", "lr_means", "sh_start", "min_views"):
        assert getattr(fine, field) == getattr(ours, field)
    assert (fine.restarts, fine.average_steps) == (3, fine.steps // 10)
    densify = coarse.densify_until + fine.densify_until
    assert densify == max(plain.densify_until, coarse.densify_until + fine.steps // 3)
    if name != "paper":
        assert coarse == config.scene
        assert densify == config.total_steps // 2


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_in_one_stage_they_begin_like_3dgs(name: str) -> None:
    config = preset(name)
    tuned, plain = stage_configs.tuned_baseline(config, False), stage_configs.baseline(config)
    assert tuned.coarse is None
    for field in ("steps", "sh_start", "densify_from", "densify_until", "grad_threshold"):
        assert getattr(tuned.fine, field) == getattr(plain, field)
    two = stage_configs.tuned_baseline(config, True).fine
    own = ("steps", "sh_start", "densify_from", "densify_until", "average_steps", "backdrop_cells")
    assert tuned.fine == replace(two, **{field: getattr(tuned.fine, field) for field in own})
    assert tuned.fine.small_until == 0
    assert tuned.fine.average_steps == config.total_steps // 10


def test_all_photos_whole_shuffled_and_everywhere(scene: SfmScene) -> None:
    config = tiny("joint", scene_scale=0.5)
    run = define_run(Path("nowhere"), scene, [BOX, SECOND], config)
    stages = by_name(plan_run(run, TUNED))
    tuned, joint = stages["tuned-scene"], stages["joint"]
    assert tuned.images == joint.images == run.train_scene.images
    assert tuned.order.kind == "shuffled" and tuned.order.count == len(tuned.images)
    assert (tuned.budgets, tuned.matched, tuned.seeing) == (None, None, ())
    assert (tuned.seed, tuned.extent) == (joint.seed, joint.extent)
    assert [roi.name for roi in tuned.rois] == [roi.name for roi in joint.rois]
    assert tuned.config.lr_shN == joint.config.lr_shN < config.roi.lr_shN  # by view spacing
    inputs = DensityInputs(
        config=tuned.config,
        extent=tuned.extent,
        rois=tuned.rois,
        budgets=None,
        photos=len(tuned.images),
        seed=0,
        device=torch.device("cpu"),
    )
    assert type(density_control(inputs, 1)) is AdaptiveDensity


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
    assert first.config.steps == own.config.steps == 20


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


def test_fingerprints_differ_where_settings_do(scene: SfmScene) -> None:
    def stages() -> list[Stage]:
        photos = PhotoSets(define_run(Path("nowhere"), scene, [BOX], tiny("joint")))
        plans = [
            full_scene_tuned(photos, coarse_to_fine=True),
            full_scene_tuned(photos, coarse_to_fine=False),
            matched_tuned(photos, strategy(photos).models[-1]),
        ]
        return [plan.stages[-1] for plan in plans]

    first = [stage.fingerprint for stage in stages()]
    assert len(set(first)) == 3
    assert [stage.fingerprint for stage in stages()] == first
    assert stages()[1].start.kind == POINTS
    assert [stage.name for stage in stages()] == ["tuned-scene", "tuned-scene", "tuned-matched"]


@pytest.mark.parametrize("name", ["joint", "independent"])
def test_the_matched_one_differs_by_its_threshold_in_the_boxes(scene: SfmScene, name: str) -> None:
    photos = PhotoSets(define_run(Path("nowhere"), scene, [BOX], tiny(name)))
    plan = matched_tuned(photos, strategy(photos).models[-1])
    stage, tuned = by_name(plan)["tuned-matched"], full_scene_tuned(photos).stages[-1]
    threshold = photos.run.config.roi.grad_threshold / 4
    assert stage.config == replace(tuned.config, box_grad_threshold=threshold)
    assert stage.start.fingerprint == tuned.start.fingerprint
    assert stage.start.inputs[0].name == tuned.start.inputs[0].name
    assert stage.matched is not None


def test_rows_and_times_of_a_run(scene: SfmScene, tmp_path: Path) -> None:
    """The shared stage is trained once and counts for both."""
    config = tiny("joint", scene_scale=0.5)
    models = train(tmp_path, scene, [BOX], config, BASELINES)
    seconds = {model.name: model.evaluated().stages for model in models}
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
    evaluated = [model.evaluated() for model in models]
    for rows, baseline in ((evaluated, "Full Scene, tuned"), (evaluated[:1], "Full Scene")):
        report = evaluate(rows, run.scene, run.measured, run.rois)
        gains = {row.model: row.peak_gain for row in report.roi("thing").rows}
        assert report.baseline == baseline and gains[baseline] is None
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("stage.json")}
    train_run(run, BASELINES)
    assert before == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("stage.json")}
