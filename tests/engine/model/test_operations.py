"""Composition: every Gaussian has one owner, and comes from the model that owns its place."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from roigs_engine.errors import RoiError
from roigs_engine.model.gaussians import NAMES, Gaussians
from roigs_engine.model.operations import crop, merge
from roigs_engine.model.ownership import owners
from roigs_engine.model.roi import OrientedBox


def cloud(rng: np.random.Generator, count: int, tag: float, bands: int = 16) -> Gaussians:
    """Random Gaussians whose colour tells which model they are from, and which row."""
    sh = rng.normal(size=(count, bands, 3))
    sh[:, 0, 0], sh[:, 0, 1] = tag, np.arange(count)
    arrays = {
        "means": rng.uniform(-2, 2, (count, 3)),
        "quats": rng.normal(size=(count, 4)),
        "log_scales": rng.normal(size=(count, 3)),
        "logit_opacities": rng.normal(size=count),
        "sh": sh,
    }
    return Gaussians.from_arrays({name: a.astype(np.float32) for name, a in arrays.items()})


def boxes(rng: np.random.Generator, count: int) -> list[OrientedBox]:
    """Boxes that often overlap."""
    out = []
    for index in range(count):
        transform = np.eye(4)
        transform[:3, :3] = Rotation.random(random_state=rng.integers(2**31)).as_matrix()
        transform[:3, 3] = rng.uniform(-1, 1, 3)
        size = rng.uniform(0.3, 1.5, 3)
        out.append(OrientedBox(name=f"roi {index}", world_to_box=transform, half_extents=size))
    return out


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
def test_every_gaussian_comes_from_the_model_that_owns_its_place(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    rois, scene = boxes(rng, count), cloud(rng, 80, -1)
    models = [cloud(rng, int(rng.integers(0, 60)), index) for index in range(count)]
    result = merge(scene, list(zip(rois, models, strict=True)))
    assert torch.equal(owners(result, rois).float(), result.sh[:, 0, 0])
    outside = int((owners(scene, rois) == -1).sum())
    inside = [len(crop(model, roi, rois)) for model, roi in zip(models, rois, strict=True)]
    assert len(result) == outside + sum(inside)
    for source, tag in [(scene, -1), *((model, k) for k, model in enumerate(models))]:
        kept = result.rows(result.sh[:, 0, 0] == tag)
        original = source.rows(kept.sh[:, 0, 1].long())
        for name in NAMES:
            assert getattr(kept, name).equal(getattr(original, name))


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_putting_the_scene_s_own_parts_back_changes_the_order_only(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rois, scene = boxes(rng, 3), cloud(rng, 60, 0)
    result = merge(scene, [(roi, scene) for roi in rois])
    assert sorted(result.sh[:, 0, 1].tolist()) == list(range(60))
    again = merge(scene, [(roi, crop(scene, roi, rois)) for roi in rois])
    assert again.means.equal(result.means)


def test_inputs_stay_as_they_are() -> None:
    rng = np.random.default_rng(0)
    (roi,), scene, model = boxes(rng, 1), cloud(rng, 40, -1), cloud(rng, 40, 0)
    before = {name: tensor.clone() for name, tensor in scene.tensors().items()}
    result = merge(scene, [(roi, model)])
    for tensor in result.tensors().values():
        tensor.add_(1)
    for name, tensor in scene.tensors().items():
        assert tensor.equal(before[name])


def test_fewer_bands_are_filled_with_zeros() -> None:
    rng = np.random.default_rng(0)
    roi = OrientedBox.between("all", [-3, -3, -3], [3, 3, 3])
    scene, model = cloud(rng, 10, -1), cloud(rng, 12, 0, bands=4)
    result = merge(scene, [(roi, model)])
    assert result.sh.shape == (12, 16, 3)
    assert result.sh[:, :4].equal(model.sh)
    assert not result.sh[:, 4:].any()


def test_no_box_and_no_gaussian() -> None:
    rng = np.random.default_rng(0)
    scene, empty = cloud(rng, 10, -1), cloud(rng, 0, 0)
    assert merge(scene, []).means.equal(scene.means)
    roi = OrientedBox.between("all", [-3, -3, -3], [3, 3, 3])
    assert len(merge(scene, [(roi, empty)])) == 0


def test_box_must_be_one_of_the_run_s() -> None:
    rng = np.random.default_rng(0)
    first, second = boxes(rng, 2)
    with pytest.raises(RoiError, match="roi 1"):
        crop(cloud(rng, 10, 0), second, [first])
