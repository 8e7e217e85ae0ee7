"""One model of models that were moved: its picture is that of the models in their places."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from roigs_engine.context import Context
from roigs_engine.errors import Stopped
from roigs_engine.exchange.transform import merged, turned_sh
from roigs_engine.formats.events import Event, Progress, StageStarted
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.model.scene import Camera
from roigs_engine.rasterize.instances import Instance, render_instances
from roigs_engine.rasterize.reference import sh_basis
from tests.engine.clouds import CAMERA, POSE, TURN, affine, cloud, on_black, placed

MIRROR = np.diag([-1.0, 1.0, 1.0])


def picture(models: list[Instance], camera: Camera = CAMERA) -> torch.Tensor:
    return on_black(render_instances(models, camera, POSE))


@pytest.mark.parametrize("linear", [TURN, 0.4 * TURN, MIRROR @ TURN], ids=str)
def test_the_picture_is_that_of_the_placed_models(linear: np.ndarray) -> None:
    models = [placed(cloud(), affine(linear, (0.2, 0.1, 0.0))), placed(cloud(seed=1))]
    model, frame = merged(models)
    one = Instance(gaussians=model, frame=frame, matrix=np.eye(4))
    torch.testing.assert_close(picture([one]), picture(models), atol=2e-3, rtol=0)
    unturned = placed(cloud(), affine(linear, (0.2, 0.1, 0.0)))
    assert len(model) == 2 * len(unturned.gaussians)


def test_colours_that_do_not_turn_would_be_seen() -> None:
    models = [placed(cloud(), affine(TURN))]
    model, frame = merged(models)
    same = Gaussians(**model.tensors() | {"sh": cloud().sh})
    one = Instance(gaussians=same, frame=frame, matrix=np.eye(4))
    assert (picture([one]) - picture(models)).abs().max() > 0.05


def test_stretched_colours_are_fitted() -> None:
    linear = np.diag([1.0, 1.0, 1.6]) @ TURN
    sh = cloud().sh
    random = np.random.default_rng(3).normal(size=(500, 3))
    after = random @ linear.T
    before, after = (
        torch.from_numpy(d / np.linalg.norm(d, axis=1, keepdims=True)) for d in (random, after)
    )
    wanted = torch.einsum("dk,nkc->dnc", sh_basis(before).float(), sh)
    turned = torch.einsum("dk,nkc->dnc", sh_basis(after).float(), turned_sh(sh, linear))
    still = torch.einsum("dk,nkc->dnc", sh_basis(after).float(), turned_sh(sh, TURN))
    assert (turned - wanted).square().mean() < 0.6 * (still - wanted).square().mean()


@pytest.mark.parametrize("bands", [1, 4, 9, 16])
def test_there_and_back_gives_the_same_coefficients(bands: int) -> None:
    sh = cloud().sh[:, :bands]
    back = turned_sh(turned_sh(sh, TURN), TURN.T)
    torch.testing.assert_close(back, sh, atol=1e-5, rtol=0)
    assert bands == 1 or (turned_sh(sh, TURN) - sh).abs().max() > 0.1


def test_one_turn_after_the_other_is_their_product() -> None:
    other = Rotation.from_euler("zyx", [20, -35, 80], degrees=True).as_matrix()
    sh = cloud().sh
    expected = turned_sh(sh, other @ TURN)
    torch.testing.assert_close(turned_sh(turned_sh(sh, TURN), other), expected, atol=1e-5, rtol=0)


def test_a_fit_leaves_no_noise() -> None:
    """Its last bits depend on the number of threads, and files would."""
    sh = torch.zeros(5, 16, 3)
    sh[:, 0] = 1000
    assert torch.equal(turned_sh(sh, Rotation.from_euler("x", 90, degrees=True).as_matrix()), sh)


def test_models_of_other_degrees_are_padded() -> None:
    plain = cloud(sh=np.ones((60, 1, 3)))
    model, _ = merged([placed(plain), placed(cloud(seed=1))])
    assert model.sh.shape == (120, 16, 3)
    assert not model.sh[:60, 1:].any()


def test_far_places_keep_their_precision() -> None:
    far = affine(np.eye(3), (4e6, 5e6, 300.0))
    model, frame = merged([placed(cloud(), far)])
    assert isinstance(frame, LocalFrame)
    back = model.means.double().numpy() / frame.scale + frame.origin - far[:3, 3]
    np.testing.assert_allclose(back, cloud().means.numpy(), atol=1e-4)


def test_a_long_list_hears_a_stop() -> None:
    asked = 0

    def stops() -> bool:
        nonlocal asked
        asked += 1
        return asked > 3

    with pytest.raises(Stopped):
        merged([placed(cloud())] * 1000, Context(should_stop=stops))
    assert asked == 4


def test_hundreds_of_models_show_progress() -> None:
    events: list[Event] = []
    for count in (20, 250):
        models = [placed(cloud(3), affine(TURN))] * count
        merged(models, Context(emit=events.append))
    assert events[0] == StageStarted(stage="models", total=250)
    assert [event.step for event in events if isinstance(event, Progress)] == [100, 200]
