"""Runs with masks of objects: what they change, and that nothing changes without."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from roigs_engine.context import Context
from roigs_engine.errors import Stopped
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.ownership import owners
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import Camera, PhotoMask, PosedImage, SfmScene
from roigs_engine.run.definition import define_run
from roigs_engine.run.manifest import manifest_difference
from roigs_engine.run.plan import POINTS, Source, Stage, result_of
from roigs_engine.run.strategies import plan_run
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms.box_density_control import BoxDensityControl
from roigs_engine.training.mechanisms.masked_steps import MaskedSteps
from roigs_engine.training.photo_order import PhotoOrder
from tests.engine.run.masked import masked
from tests.engine.runs import finished, plys, stage_of, tiny, train
from tests.engine.settings import without
from tests.engine.synthetic_scene import BOX, make_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


@pytest.fixture(scope="module")
def with_masks(scene: SfmScene, tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return masked(scene, tmp_path_factory.mktemp("masks"))


def stages(**of_photos: object) -> tuple[Stage, Stage]:
    camera = Camera(width=96, height=72, fx=90.0, fy=90.0, cx=48.0, cy=36.0)
    images = tuple(
        PosedImage(
            name=name,
            path=Path(name),
            camera=camera,
            world_to_camera=np.eye(4),
            point_indices=np.zeros(0, np.int64),
            digest=f"d{name}",
            **of_photos,
        )
        for name in "ab"
    )
    scene = Stage(
        name="scene",
        images=images,
        config=TrainConfig(steps=2),
        start=Source(kind=POINTS, digest="p"),
        order=PhotoOrder(kind="shuffled", count=2, seed=0),
        extent=1.5,
        seed=0,
    )
    box = OrientedBox(name="thing", world_to_box=np.eye(4), half_extents=np.ones(3))
    joint = replace(
        scene,
        name="joint",
        config=TrainConfig(
            steps=3,
            mechanisms=(MaskedSteps(seeing=(0, 1)), BoxDensityControl(budget=26.0, budgets=(7,))),
        ),
        start=result_of(scene),
        rois=(box,),
    )
    return scene, joint


def test_a_stage_depends_on_the_masks_it_uses() -> None:
    mask = PhotoMask(
        digest="m", path=Path("m"), remake=lambda: None, small=np.zeros((1, 1), np.uint8)
    )
    (plain_scene, plain), (scene, joint) = stages(), stages(objects={"thing": mask})
    assert scene.fingerprint == plain_scene.fingerprint
    assert joint.fingerprint != plain.fingerprint
    renamed = replace(
        joint,
        rois=tuple(replace(roi, name="pot") for roi in joint.rois),
        images=tuple(replace(image, objects={"pot": mask}) for image in joint.images),
    )
    assert renamed.fingerprint == joint.fingerprint
    _, other = stages(objects={"other": mask})
    assert other.fingerprint == plain.fingerprint
    whole = replace(joint, config=without(joint.config, MaskedSteps))
    assert whole.fingerprint == replace(plain, config=whole.config).fingerprint


@pytest.mark.parametrize("strategy", ["joint", "independent"])
def test_masks_of_other_boxes_change_no_byte(
    scene: SfmScene, tmp_path: Path, strategy: str
) -> None:
    train(tmp_path / "plain", scene, [BOX], tiny(strategy))
    train(tmp_path / "other", masked(scene, tmp_path, "other"), [BOX], tiny(strategy))
    assert plys(tmp_path / "plain") == plys(tmp_path / "other")
    manifests = [(tmp_path / name / "manifest.json").read_bytes() for name in ("plain", "other")]
    assert manifests[0] == manifests[1] and b"object_masks" not in manifests[0]


@pytest.mark.parametrize("strategy", ["joint", "independent"])
def test_the_parts_are_objects_and_add_up(
    with_masks: SfmScene, tmp_path: Path, strategy: str
) -> None:
    trained = train(tmp_path, with_masks, [BOX], tiny(strategy))
    assert ("cutout" in finished(tmp_path)) == (strategy == "joint")
    assert (trained[-1].name == "Joint, cut out") == (strategy == "joint")
    names = (
        "result.ply",
        "rois/thing.ply",
        "background.ply",
        "coarse/thing.ply",
        f"{stage_of(tmp_path, 'scene')}/model.ply",
    )
    whole, part, rest, coarse, scene = (Gaussians.load_ply(tmp_path / name) for name in names)
    rows = {tuple(row) for row in torch.cat([part.means, rest.means]).tolist()}
    assert len(part) + len(rest) == len(whole) and rows == {tuple(r) for r in whole.means.tolist()}
    for model, found in ((whole, part), (scene, coarse)):
        owned = int((owners(model, [BOX]) == 0).sum())
        assert 0 < len(found) < 0.9 * owned
        assert (owners(found, [BOX]) == 0).all()


def test_a_stopped_run_with_masks_goes_on_to_the_same_bytes(
    with_masks: SfmScene, tmp_path: Path
) -> None:
    train(tmp_path / "whole", with_masks, [BOX], tiny("joint"))
    asked = 0

    def sometimes() -> bool:
        nonlocal asked
        asked += 1
        return asked in (30, 90, 150, 200)

    stops = 0
    while True:
        try:
            context = Context(should_stop=sometimes)
            train(tmp_path / "cut", with_masks, [BOX], tiny("joint"), context=context)
            break
        except Stopped:
            stops += 1
    assert stops >= 2 and plys(tmp_path / "cut") == plys(tmp_path / "whole")


def test_the_plan_has_a_smaller_budget_and_another_merge(
    scene: SfmScene, with_masks: SfmScene, tmp_path: Path
) -> None:
    plans = [plan_run(define_run(tmp_path, s, [BOX], tiny("joint"))) for s in (scene, with_masks)]
    (plain,), (half,) = (
        [s.config.of(BoxDensityControl).budgets for s in plan.stages if s.name == "joint"]
        for plan in plans
    )
    assert plain is not None and half is not None
    assert half[0] == pytest.approx(plain[0] * 0.5**0.5, rel=0.1)
    assert [stage.name for stage in plans[0].stages] == ["scene", "joint"]
    assert [stage.name for stage in plans[1].stages] == ["scene", "joint", "cutout"]
    merges = [
        plan_run(define_run(tmp_path, s, [BOX], tiny("independent"))).models[-1].source.fingerprint
        for s in (scene, with_masks)
    ]
    assert merges[0].startswith("merge::") and not merges[1].startswith("merge::")


def test_changed_masks_are_named() -> None:
    before = {"rois": [{"name": "pot"}], "object_masks": {"pot": {"a.jpg": "1", "b.jpg": "1"}}}
    now = {"rois": [{"name": "pot"}], "object_masks": {"pot": {"a.jpg": "2", "b.jpg": "1"}}}
    assert manifest_difference(before, now) == "box 'pot': the mask of a.jpg changed"
    assert "2 masks are new" in manifest_difference({}, {"object_masks": before["object_masks"]})
