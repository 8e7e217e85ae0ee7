"""Labels by votes of masks: an object without the table it stands on."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from roigs_engine.context import Context
from roigs_engine.errors import Stopped
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import Camera
from roigs_engine.rasterize.view import render_view
from roigs_engine.training.labels import MaskedView, mask_votes, object_rows
from tests.poses import look_at

CAMERA = Camera(width=96, height=72, fx=90.0, fy=90.0, cx=48.0, cy=36.0)


def scene() -> tuple[Gaussians, torch.Tensor]:
    """A ball on a plate, in one box, and which Gaussians are the ball's."""
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(1500, 3))
    ball *= (0.4 * rng.uniform(0, 1, 1500) ** (1 / 3) / np.linalg.norm(ball, axis=1))[:, None]
    plate = np.column_stack([rng.uniform(-0.9, 0.9, (900, 2)), rng.normal(-0.47, 0.01, 900)])
    places = np.concatenate([ball, plate])
    model = Gaussians.from_points(places, rng.integers(0, 256, places.shape).astype(np.uint8))
    model.log_scales.fill_(float(np.log(0.03)))
    model.logit_opacities.fill_(3.0)
    return model, torch.arange(len(places)) < 1500


def views(model: Gaussians, ball: torch.Tensor, count: int) -> list[MaskedView]:
    """True masks of the ball from a part of a ring."""
    found = []
    for k in range(count):
        angle = 2 * np.pi * k / max(count, 5)
        pose = look_at(np.array([2 * np.cos(angle), 2 * np.sin(angle), 0.9]))
        alone, black = model.rows(ball), torch.zeros(3)
        alone.sh.zero_()  # grey: as bright as it is opaque
        mask = render_view(alone, CAMERA, pose, background=black).image[..., 0] > 0.25
        found.append(MaskedView(CAMERA, pose, mask))
    return found


def test_a_ball_is_cut_from_its_plate_by_five_masks() -> None:
    model, ball = scene()
    every = torch.ones(len(model), dtype=torch.bool)
    masks = views(model, ball, 5)
    found = object_rows(model, mask_votes(model, masks), every)
    assert float((found == ball).float().mean()) > 0.97
    pose = look_at(np.array([1.4, 1.5, 0.8]))  # no mask is from here
    pictures = []
    for rows in (found, ball):
        part = model.rows(rows)
        part.sh.zero_()
        pictures.append(render_view(part, CAMERA, pose).image[..., 0] > 0.25)
    mine, true = pictures
    assert float((mine & true).sum() / (mine | true).sum()) > 0.95


def test_votes_are_the_blending_weights_of_the_masks_pixels() -> None:
    model, ball = scene()
    (view,) = views(model, ball, 1)
    yes, no = mask_votes(model, [view])
    camera, pose, mask, _ = view
    swapped = mask_votes(model, [view._replace(mask=~mask)])
    assert torch.allclose(yes, swapped[1], atol=1e-3) and torch.allclose(no, swapped[0], atol=1e-3)
    # All weights of a pixel and what is behind the last Gaussian are 1.
    total = float((yes + no).sum())
    alone = model.rows(torch.ones(len(model), dtype=torch.bool))
    alone.sh.zero_()
    light = float(render_view(alone, camera, pose).image[..., 0].sum())
    assert total == pytest.approx(2 * light, rel=1e-3)


def test_only_candidates_are_found_and_the_unseen_go_with_their_neighbours() -> None:
    model, ball = scene()
    none = torch.zeros(len(model), dtype=torch.bool)
    votes = mask_votes(model, views(model, ball, 1))
    assert not object_rows(model, votes, none).any()
    assert torch.equal(object_rows(model, votes, ball) & ~ball, none)
    unseen = (votes[0] + votes[1]) < 1 / 255
    assert (unseen & ball).sum() > 100  # its inside and its back
    found = object_rows(model, votes, torch.ones_like(none))
    assert float(found[unseen & ball].float().mean()) > 0.8
    nothing = (torch.zeros(len(model)), torch.zeros(len(model)))
    assert not object_rows(model, nothing, ~none).any()


def test_a_stop_is_heard() -> None:
    model, ball = scene()
    with pytest.raises(Stopped):
        mask_votes(model, views(model, ball, 1), Context(should_stop=lambda: True))
