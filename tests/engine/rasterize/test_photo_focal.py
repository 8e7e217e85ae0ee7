"""Pictures of other sizes than the photos': the blur is that of the photos, an angle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from roigs_engine.formats.splat_ply import made_of
from roigs_engine.formats.targets import CYCLES, PLAIN, VIEWERS, Target
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.model.scene import Camera
from roigs_engine.rasterize.instances import Instance, render_instances
from roigs_engine.rasterize.view import blending_weights, pixel_size, render_view
from tests.engine.rasterize_cases import gaussians, relative_error

SIDE, FOCAL = 64, 60.0
FRAME = LocalFrame.world()


def camera(factor: float) -> Camera:
    side = round(SIDE * factor)
    focal = FOCAL * factor
    return Camera(width=side, height=side, fx=focal, fy=focal, cx=side / 2, cy=side / 2)


def model(target: Target = VIEWERS, photo_focal: float | None = FOCAL) -> Gaussians:
    means, quats, scales, opacities, sh = gaussians(800, size=0.02)
    return Gaussians(
        means=means,
        quats=quats,
        log_scales=scales.log(),
        logit_opacities=torch.logit(opacities),
        sh=sh,
        target=target,
        photo_focal=photo_focal,
    )


def picture(of: Gaussians, factor: float) -> Tensor:
    return render_view(of, camera(factor), np.eye(4)).image.double()


def halved(image: Tensor) -> Tensor:
    side = len(image) // 2
    return image.reshape(side, 2, side, 2, 3).mean((1, 3))


@pytest.mark.parametrize("target", [VIEWERS, PLAIN])
def test_a_smaller_picture_is_the_average_of_the_photos_size(target: Target) -> None:
    whole = halved(picture(model(target), 1))
    known = relative_error(picture(model(target), 0.5), whole)
    assert known < 0.5 * relative_error(picture(model(target, None), 0.5), whole)


@pytest.mark.parametrize("target", [VIEWERS, PLAIN])
def test_a_larger_picture_averages_to_the_photos_size(target: Target) -> None:
    whole = picture(model(target), 1)
    known = relative_error(halved(picture(model(target), 2)), whole)
    assert known < 0.5 * relative_error(halved(picture(model(target, None), 2)), whole)


def test_the_photos_size_and_weights_have_the_same_bits() -> None:
    known, unknown = model(), model(photo_focal=None)
    assert torch.equal(picture(known, 1), picture(unknown, 1))
    views = [(camera(0.3), np.eye(4))]
    ours, theirs = (next(iter(blending_weights(m, views))) for m in (known, unknown))
    assert torch.equal(ours.largest, theirs.largest)


@pytest.mark.parametrize("factor", [0.5, 2])
def test_what_is_made_for_cycles_has_only_a_pixels_own_blur(factor: float) -> None:
    known, unknown = (picture(model(CYCLES, focal), factor) for focal in (FOCAL, None))
    assert torch.allclose(known, unknown, atol=1e-4)


def test_parallel_rays_have_no_angle_and_close_ups_a_limit() -> None:
    far = replace(camera(1), fx=1e6, fy=1e6)
    assert pixel_size(model(), far) == 1.0
    near = replace(camera(1), fx=50 * FOCAL, fy=50 * FOCAL)
    assert pixel_size(model(), near) == 1 / 16
    assert pixel_size(model(photo_focal=None), camera(3)) == 1.0


@pytest.mark.parametrize("targets", [(VIEWERS, VIEWERS), (VIEWERS, PLAIN)])
@pytest.mark.parametrize("factor", [0.5, 1, 2])
def test_models_of_different_photos_are_drawn_together(
    targets: tuple[Target, Target], factor: float
) -> None:
    """Side by side, each about as it is alone, though both get the wider blur."""
    models = []
    for target, focal, beside in zip(targets, (FOCAL, 1.5 * FOCAL), (-20.0, 20.0), strict=True):
        means = model().means * 0.3 + torch.tensor([beside / 10, 0.0, 5.0])
        own = replace(model(target, focal), means=means)
        models.append(Instance(gaussians=own, frame=FRAME, matrix=np.eye(4)))
    together = light(models, factor)
    alone = light(models[:1], factor) + light(models[1:], factor)
    assert float(alone.sum()) > 10
    assert relative_error(together, alone) < 0.15


def light(models: list[Instance], factor: float) -> Tensor:
    layer = render_instances(models, camera(factor), np.eye(4))
    return (layer.image * layer.alpha[..., None]).double()


def test_a_ply_keeps_it(tmp_path: Path) -> None:
    path = tmp_path / "model.ply"
    model(photo_focal=1063.3751885367235).save_ply(path)
    assert Gaussians.load_ply(path).photo_focal == 1063.3751885367235
    assert Gaussians.load_framed(path)[0].photo_focal == 1063.3751885367235
    model(photo_focal=None).save_ply(path)
    assert Gaussians.load_ply(path).photo_focal is None


@pytest.mark.parametrize("said", ["nan", "-5", "0", "1e99", "x", "", "5 6", "1e-9"])
def test_a_strange_value_counts_as_none(tmp_path: Path, said: str) -> None:
    path = tmp_path / "model.ply"
    model().save_ply(path)
    data = path.read_bytes().replace(b"photo_focal 60.0", b"photo_focal " + said.encode())
    path.write_bytes(data)
    assert made_of(path)["photo_focal"] is None


def test_parts_of_one_model_keep_it() -> None:
    first = model()
    assert first.rows(torch.arange(5)).photo_focal == FOCAL
    assert Gaussians.concatenate([first, model(photo_focal=None)]).photo_focal == FOCAL


def test_models_in_one_have_the_widest_blur_of_them() -> None:
    parts = [model(photo_focal=focal) for focal in (2 * FOCAL, FOCAL, None)]
    joined = Gaussians.concatenate(parts)
    assert joined.photo_focal == FOCAL
    assert pixel_size(joined, camera(2)) == 0.5  # a pixel is half of a photo's: the blur is wide
