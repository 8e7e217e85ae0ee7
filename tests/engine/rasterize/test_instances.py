"""Models that were moved, turned, scaled, sheared and mirrored, drawn together as a layer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from roigs_engine.formats.targets import BLUR, CYCLES, PLAIN, VIEWERS, target_with
from roigs_engine.rasterize.instances import NOTHING, Instance, render_instances
from roigs_engine.rasterize.light import to_linear, to_srgb
from roigs_engine.rasterize.limits import PICTURE_LIMITS
from roigs_engine.rasterize.view import rasterize_view, render_view
from tests.engine.clouds import CAMERA, POSE, TURN, affine, cloud, on_black, placed


def test_where_it_was_trained_it_is_the_usual_picture() -> None:
    layer = render_instances([placed(cloud())], CAMERA, POSE)
    usual = render_view(cloud(), CAMERA, POSE)
    assert usual.image.std() > 0.05
    torch.testing.assert_close(on_black(layer), usual.image, atol=2e-3, rtol=0)
    covered = layer.alpha > 0
    depth = rasterize_view(cloud(), CAMERA, POSE, limits=PICTURE_LIMITS, with_depth="median").depth
    assert depth is not None
    torch.testing.assert_close(layer.depth[covered], depth[0][covered], atol=1e-3, rtol=0)
    assert (layer.depth[~covered] == NOTHING).all()


@pytest.mark.parametrize("scale", [1e-3, 7.0, 1e4])
def test_a_world_that_moves_with_its_camera_looks_the_same(scale: float) -> None:
    matrix = affine(scale * TURN, (1e3 * scale, -50 * scale, 3 * scale))
    pose = affine(POSE[:3, :3] @ TURN.T)
    pose[:3, 3] = scale * POSE[:3, 3] - pose[:3, :3] @ matrix[:3, 3]
    still, moved = (
        render_instances([placed(cloud(), m)], CAMERA, p)
        for m, p in ((np.eye(4), POSE), (matrix, pose))
    )
    torch.testing.assert_close(on_black(moved), on_black(still), atol=2e-3, rtol=0)
    covered = still.alpha > 0.01
    torch.testing.assert_close(
        moved.depth[covered], still.depth[covered] * scale, atol=0, rtol=1e-3
    )


def test_stretching_a_ball_makes_an_ellipsoid() -> None:
    ball = {"means": np.zeros((1, 3)), "quats": np.array([[1.0, 0, 0, 0]])}
    stretch = np.diag([2.0, 1.0, 0.5])
    sheared = render_instances(
        [placed(cloud(1, log_scales=np.log(np.full((1, 3), 0.2)), **ball), affine(TURN @ stretch))],
        CAMERA,
        POSE,
    )
    direct = render_instances(
        [placed(cloud(1, log_scales=np.log([[0.4, 0.2, 0.1]]), **ball), affine(TURN))], CAMERA, POSE
    )
    torch.testing.assert_close(sheared.alpha, direct.alpha, atol=1e-3, rtol=0)


def test_a_mirror_image_is_mirrored() -> None:
    plain = render_instances([placed(cloud())], CAMERA, POSE)
    mirrored = render_instances([placed(cloud(), np.diag([-1.0, 1, 1, 1]))], CAMERA, POSE)
    torch.testing.assert_close(on_black(mirrored), on_black(plain).flip(1), atol=2e-3, rtol=0)


def wall(z: float, opacity: float = 0.99999, seed: int = 0) -> Instance:
    """Covers the picture, at z + 4 before the camera."""
    gaussian = {
        "means": np.zeros((1, 3)),
        "log_scales": np.log([[50.0, 50.0, 0.01]]),
        "quats": np.array([[1.0, 0, 0, 0]]),
        "logit_opacities": np.log([opacity / (1 - opacity)]),
    }
    return placed(cloud(1, seed=seed, **gaussian), affine(np.eye(3), (0, 0, z)))


def test_a_mesh_behind_an_object_that_lets_light_through_stays_behind_it() -> None:
    """The compositor puts a mesh in front where its depth is less than the layer's."""
    object_, far, mesh = wall(-1.0, opacity=0.9), wall(26.0, seed=1), 5.0
    layer = render_instances([far, object_], CAMERA, POSE)
    assert float(layer.alpha.min()) > 0.99
    assert float(layer.depth.max()) < mesh
    thin = render_instances([far, wall(-1.0, opacity=0.4)], CAMERA, POSE)
    assert float(thin.depth.min()) > mesh


def test_the_nearer_model_covers_the_other() -> None:
    back, front = wall(1.0, seed=1), wall(-1.0, seed=2)
    both = render_instances([back, front], CAMERA, POSE)
    alone = render_instances([front], CAMERA, POSE)
    torch.testing.assert_close(both.image, alone.image, atol=1e-2, rtol=0)
    assert float(both.depth[24, 32]) == pytest.approx(3.0, abs=0.05)


def test_models_with_other_numbers_of_sh_bands_go_together() -> None:
    few = cloud(5, sh=np.zeros((5, 4, 3)))
    assert render_instances([placed(cloud()), placed(few)], CAMERA, POSE).alpha.max() > 0.5


def test_a_layer_of_linear_light_is_composited_in_linear_light() -> None:
    model = replace(cloud(), target=CYCLES)
    layer, usual = render_instances([placed(model)], CAMERA, POSE), render_view(model, CAMERA, POSE)
    over_black = to_srgb(to_linear(layer.image) * layer.alpha[..., None])
    torch.testing.assert_close(over_black, usual.image, atol=3e-3, rtol=0)
    few = replace(cloud(5, seed=1), target=VIEWERS)  # drawn in the light of most, with its own blur
    wide = render_instances(
        [placed(replace(model, target=replace(CYCLES, blur=BLUR)))], CAMERA, POSE
    )
    both = render_instances([placed(model), placed(few)], CAMERA, POSE)
    assert (both.alpha >= wide.alpha - 1e-3).all()


def test_models_with_and_without_antialiasing_are_each_drawn_right() -> None:
    fine = {"log_scales": np.random.default_rng(5).uniform(np.log(0.004), np.log(0.1), (60, 3))}
    plain, smooth = cloud(seed=1, **fine), replace(cloud(seed=2, **fine), target=VIEWERS)
    turned = affine(1.3 * TURN)
    nothing = cloud(1, means=np.full((1, 3), 1e3))
    for model in (plain, smooth):
        alone = render_instances([placed(model, turned)], CAMERA, POSE)
        other = replace(nothing, target=target_with(antialiased=not model.antialiased))
        both = render_instances([placed(other), placed(model, turned)], CAMERA, POSE)
        assert alone.alpha.max() > 0.1
        torch.testing.assert_close(on_black(both), on_black(alone), atol=1e-3, rtol=0)
    changed = replace(smooth, target=PLAIN)
    as_plain = render_instances([placed(changed, turned)], CAMERA, POSE)
    assert (as_plain.alpha - alone.alpha).max() > 0.1
