"""The shares of objects in a picture: drawn, averaged, ranked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from roigs_engine.formats.frame_requests import RANKS
from roigs_engine.formats.targets import CYCLES, VIEWERS
from roigs_engine.rasterize.instances import Instance, mean_layer, render_instances
from roigs_engine.rasterize.mattes import ranked
from roigs_engine.rasterize.panorama import render_panorama
from tests.engine.clouds import CAMERA, POSE, TURN, affine, cloud, placed


def objects(count: int) -> list[Instance]:
    """Clouds through one another; the indices 0, 2, 4, ..."""
    clouds = [placed(cloud(60 + k, seed=k), affine(TURN)) for k in range(count)]
    return [replace(each, object_index=2 * k) for k, each in enumerate(clouds)]


def disc(z: float, opacity: float, index: int) -> Instance:
    """A soft disc in the middle of the picture, at z + 4 before the camera."""
    shape = {
        "means": np.array([[0.0, 0, z]]),
        "log_scales": np.log([[0.4, 0.4, 0.01]]),
        "quats": np.array([[1.0, 0, 0, 0]]),
        "logit_opacities": np.log([opacity / (1 - opacity)]),
    }
    return replace(placed(cloud(1, **shape)), object_index=index)


@pytest.mark.parametrize("target", [VIEWERS, CYCLES])
@pytest.mark.parametrize("count", [1, 2, 6])
def test_shares_add_up_to_alpha(count: int, target: object) -> None:
    models = [
        replace(each, gaussians=replace(each.gaussians, target=target)) for each in objects(count)
    ]
    layer = render_instances(models, CAMERA, POSE, mattes=True)
    assert sorted(layer.shares) == [2 * k for k in range(count)]
    assert all(share.max() > 0.1 for share in layer.shares.values())
    torch.testing.assert_close(sum(layer.shares.values()), layer.alpha, atol=1e-3, rtol=0)
    usual = render_instances(models, CAMERA, POSE)
    assert not usual.shares
    torch.testing.assert_close(layer.image, usual.image, atol=0, rtol=0)
    torch.testing.assert_close(layer.alpha, usual.alpha, atol=0, rtol=0)


def test_an_object_in_front_leaves_the_one_behind_the_rest() -> None:
    front, behind = disc(-1.0, 0.75, 7), disc(1.0, 0.99, 3)
    shares = render_instances([behind, front], CAMERA, POSE, mattes=True).shares
    alone = render_instances([front], CAMERA, POSE).alpha
    hidden = render_instances([behind], CAMERA, POSE).alpha * (1 - alone)
    torch.testing.assert_close(shares[7], alone, atol=2e-3, rtol=0)
    torch.testing.assert_close(shares[3], hidden, atol=2e-3, rtol=0)


def test_parts_with_one_index_are_one_object() -> None:
    one, two, other = objects(3)
    apart = render_instances([one, two, other], CAMERA, POSE, mattes=True).shares
    together = [replace(each, object_index=9) for each in (one, two)]
    joined = render_instances([*together, other], CAMERA, POSE, mattes=True).shares
    torch.testing.assert_close(joined[9], apart[0] + apart[2], atol=1e-3, rtol=0)


def test_the_mean_of_samples_is_that_of_their_shares() -> None:
    """Hidden surfaces have no share in that sample; an object may be in some samples only."""
    one, two = objects(2)
    layer = render_instances([one, two], CAMERA, POSE, mattes=True)
    alone = render_instances([one], CAMERA, POSE, mattes=True)
    nothing, wall = torch.full_like(layer.depth, 1e10), torch.zeros_like(layer.depth)
    mean = mean_layer([(layer, nothing), (alone, nothing), (layer, wall), (alone, wall)])
    torch.testing.assert_close(mean.shares[0], (layer.shares[0] + alone.shares[0]) / 4)
    torch.testing.assert_close(mean.shares[2], layer.shares[2] / 4)
    torch.testing.assert_close(sum(mean.shares.values()), mean.alpha, atol=1e-3, rtol=0)


def test_a_panorama_has_the_shares_of_its_pinhole_picture() -> None:
    models = objects(2)
    y, x = np.mgrid[: CAMERA.height, : CAMERA.width] + 0.5
    rays = np.stack(
        [(x - CAMERA.cx) / CAMERA.fx, (y - CAMERA.cy) / CAMERA.fy, np.ones_like(x)], axis=-1
    )
    directions = torch.from_numpy(rays.astype(np.float32))
    found = render_panorama(models, directions, CAMERA.fx, POSE, mattes=True)
    usual = render_instances(models, CAMERA, POSE, mattes=True)
    assert sorted(found.shares) == sorted(usual.shares)
    for index, share in usual.shares.items():
        assert (found.shares[index] - share).square().mean().sqrt() < 0.025 < share.std() / 5
    torch.testing.assert_close(sum(found.shares.values()), found.alpha, atol=1e-3, rtol=0)


def test_the_largest_shares_are_first() -> None:
    values = {0: 0.1, 4: 0.0, 7: 0.3, 32767: 0.2, 9: 0.05}
    indices, shares = ranked({index: torch.full((2, 3), v) for index, v in values.items()})
    assert indices.shape == shares.shape == (2, 3, RANKS)
    assert indices[1, 2].tolist() == [7, 32767, 0]
    assert shares[1, 2].tolist() == pytest.approx([0.3, 0.2, 0.1])
    few, parts = ranked({5: torch.tensor([[0.5, 0.0]])})
    assert few[0].tolist() == [[5, 0, 0], [0, 0, 0]]
    assert parts[0].tolist() == [[0.5, 0, 0], [0, 0, 0]]
