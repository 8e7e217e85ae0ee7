"""Ownership among several models of one scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from roigs_engine.model.ownership import Partition, joined
from roigs_engine.model.roi import OrientedBox
from tests.engine.synthetic_scene import truth

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-1, 1, (400, 3))
BOX = OrientedBox.between("vase", [-0.2, -0.2, -0.2], [0.3, 0.3, 0.3])


def halves(box_owner: int = 1) -> Partition:
    """Two halves along x; the box, across their border, is one's."""
    owner = (POINTS[:, 0] > 0).astype(np.int64)
    return Partition(points=POINTS, owner=owner, rois=(BOX,), roi_owner=(box_owner,))


def test_a_position_belongs_to_the_points_around_it() -> None:
    far = np.array([[-0.8, 0.5, 0.5], [0.8, 0.5, 0.5], [-90.0, 0, 0], [90.0, 0, 0]])
    assert halves().owners(far).tolist() == [0, 1, 0, 1]


def test_a_box_is_never_cut() -> None:
    inside = RNG.uniform(-0.2, 0.3, (100, 3))
    for owner in (0, 1):
        assert set(halves(owner).owners(inside)) == {owner}


def test_what_is_no_position_has_an_owner() -> None:
    assert halves().owners(np.array([[np.nan, 0, 0], [np.inf, 0, 0]])).tolist() == [0, 0]


def test_one_point_is_enough() -> None:
    one = replace(halves(), points=POINTS[:1], owner=np.array([1]), rois=(), roi_owner=())
    assert one.owners(POINTS).tolist() == [1] * len(POINTS)


def test_the_units_do_not_matter() -> None:
    places = RNG.uniform(-2, 2, (200, 3))
    large = replace(halves(), points=POINTS * 1000, rois=(), roi_owner=())
    small = replace(halves(), rois=(), roi_owner=())
    assert (large.owners(places * 1000) == small.owners(places)).all()


def test_joined_models_have_each_position_once() -> None:
    models = [truth(300, seed=0), truth(300, seed=0)]
    partition = halves()
    result = joined(models, partition)
    assert len(result) == 300  # of two equal models, one
    mine = {tuple(row) for row in models[0].means.tolist()}
    assert {tuple(row) for row in result.means.tolist()} == mine
    owners = partition.owners(result.means.double().numpy())
    assert (np.diff(owners) >= 0).all()  # the first model's first
    assert torch.equal(joined(models, partition).sh, result.sh)


def test_the_digest_tells_owners_apart() -> None:
    assert halves(0).digest != halves(1).digest
    assert halves().digest == halves().digest
    renamed = replace(halves(), rois=(replace(BOX, name="tin"),))
    assert renamed.digest == halves().digest
