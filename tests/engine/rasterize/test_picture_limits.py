"""`limits`: Gaussians far beside the image, or that reach behind the camera, are not drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from roigs_engine.errors import EngineError
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.rotations import rotation_matrices
from roigs_engine.model.scene import Camera, PosedImage
from roigs_engine.rasterize import RenderOutput, rasterize
from roigs_engine.rasterize.inputs import NEAR
from roigs_engine.rasterize.limits import (
    MAX_SLOPE,
    MIN_SIGMAS,
    NO_LIMITS,
    PICTURE_LIMITS,
    Limits,
)
from roigs_engine.rasterize.view import blending_weights, rasterize_view, render_view
from roigs_engine.training.floaters import consistent_across_views
from tests.engine.rasterize_cases import (
    BACKGROUND,
    differentiate,
    gaussians,
    gradient_errors,
    largest_difference,
    render_both,
)

SIZE = (64, 48)
FOCAL = 60.0
BACKENDS = ["reference", "cpu"]
BESIDE = Limits(max_slope=MAX_SLOPE)
BEHIND = Limits(min_sigmas=MIN_SIGMAS)


def intrinsics(focal: float = FOCAL, cx: float = 30.0, cy: float = 27.0) -> Tensor:
    return torch.tensor([[[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]]])


def at_slope(x: float, y: float, depth: float, sigma: float) -> list[Tensor]:
    """One opaque ball at this x / z and y / z; `sigma` is its size as a share of the depth."""
    _, quats, _, _, sh = gaussians(1, coefficients=1)
    mean = torch.tensor([[x, y, 1.0]]) * depth
    return [mean, quats, torch.full((1, 3), sigma * depth), torch.tensor([0.9]), sh]


def needle() -> list[Tensor]:
    """As training makes them from few photos: 3.5 long, its centre just before the camera plane."""
    means = torch.tensor([[1.0, 0.2, 0.05]])
    quats = torch.tensor([[1.0, 0.0, 0.0, 0.0]])
    colour = torch.full((1, 1, 3), 1.0)
    return [means, quats, torch.tensor([[0.016, 0.27, 3.5]]), torch.tensor([0.9]), colour]


def draw(
    backend: str, parameters: list[Tensor], pinhole: Tensor | None = None, **options: Any
) -> RenderOutput:
    pinhole = intrinsics() if pinhole is None else pinhole
    options = {"limits": BESIDE, **options}
    return rasterize(*parameters, torch.eye(4)[None], pinhole, *SIZE, backend=backend, **options)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("limits", [BESIDE, BEHIND], ids=["beside", "behind"])
def test_a_needle_beside_the_camera_is_no_fog(backend: str, limits: Limits) -> None:
    """The EWA approximation draws it over the whole image."""
    assert draw(backend, needle(), limits=NO_LIMITS).alpha.min() > 0.15
    output = draw(backend, needle(), limits=limits)
    assert not output.visible.any()
    assert not output.alpha.any() and not output.image.any()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("focal", [FOCAL, 25.0], ids=["narrow", "wide"])
@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
@pytest.mark.parametrize("inside", [True, False])
def test_it_limits_each_side(backend: str, focal: float, side: str, inside: bool) -> None:
    slope = MAX_SLOPE + (-0.01 if inside else 0.01)
    x, y = {"left": (-1, 0), "right": (1, 0), "top": (0, -1), "bottom": (0, 1)}[side]
    ball = at_slope(x * slope, y * slope, depth=2.0, sigma=3.0)
    output = draw(backend, ball, intrinsics(focal))
    assert bool(output.visible.any()) == inside
    assert bool(output.alpha.any()) == inside
    assert draw(backend, ball, intrinsics(focal), limits=NO_LIMITS).visible.any()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("max_slope", [MAX_SLOPE, 0.0])
def test_what_is_inside_the_image_is_drawn_at_any_slope(backend: str, max_slope: float) -> None:
    pinhole = intrinsics(8.0)  # 152 degrees: slopes to 4.25
    for x, seen in ((4.0, True), (4.4, False)):
        output = draw(
            backend, at_slope(x, 0.0, 2.0, 1.0), pinhole, limits=Limits(max_slope=max_slope)
        )
        assert bool(output.visible.any()) == seen


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_zoomed_camera_draws_the_same_gaussians(backend: str) -> None:
    """Four times the focal length: its picture is the crop of the whole one at that resolution."""
    width, height = SIZE
    camera = torch.eye(4)[None]
    options = {"limits": BESIDE, "backend": backend}
    zoomed = intrinsics(4 * FOCAL, 4 * 30.0, 4 * 27.0)
    moved = intrinsics(4 * FOCAL, 4 * 30.0 - 96, 4 * 27.0 - 64)
    sight = at_slope(0.0, 0.0, 2.0, 0.02)
    beside = at_slope(2.5, 0.0, 2.0, 3.0)  # nine widths beside the second picture
    for ball in (sight, beside):
        parameters = [torch.cat(parts) for parts in zip(ball, needle(), strict=True)]
        whole = rasterize(*parameters, camera, zoomed, 4 * width, 4 * height, **options)
        part = rasterize(*parameters, camera, moved, width, height, **options)
        assert whole.visible.tolist() == part.visible.tolist() == [[True, False]]
        crop = whole.image[0, 64 : 64 + height, 96 : 96 + width]
        assert crop.any() and part.image.any()
        if ball is sight:  # beside the view, the Jacobian's limits change a Gaussian's shape
            assert largest_difference(crop, part.image[0]) < 1e-4


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_mask_does_not_move_the_limit(backend: str) -> None:
    corner = (48, 32, 64, 48)
    for slope, seen in ((MAX_SLOPE - 0.1, True), (MAX_SLOPE + 0.1, False)):
        output = draw(backend, at_slope(-slope, 0.0, 2.0, 3.0), mask=corner)
        assert bool(output.alpha[0, 32:, 48:].all()) == seen
        assert not output.alpha[0, :32].any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_each_camera_has_its_own_limit(backend: str) -> None:
    """A Gaussian that one camera leaves out has the gradient of the other one alone."""
    ball = at_slope(0.0, 0.0, 2.0, 0.1)
    parameters = [torch.cat(pair) for pair in zip(needle(), ball, strict=True)]
    views = torch.eye(4).repeat(2, 1, 1)
    views[1, 2, 3] = 2.0  # farther back; from there the needle is in sight
    pinholes = intrinsics().repeat(2, 1, 1)
    dtype = torch.float64 if backend == "reference" else torch.float32
    output, gradients = differentiate(
        backend, dtype, parameters, views, pinholes, *SIZE, limits=BESIDE
    )
    assert output.visible.tolist() == [[False, True], [True, True]]
    assert torch.equal(output.grad2d > 0, output.visible)
    leaves = [p.to(dtype).requires_grad_() for p in parameters]
    options = {"limits": BESIDE, "backend": backend}
    alone = rasterize(*leaves, views[1:].to(dtype), pinholes[1:].to(dtype), *SIZE, **options)
    weights = torch.randn(output.image.shape, generator=torch.Generator().manual_seed(1))[1]
    (alone.image[0] * weights.to(dtype)).sum().backward()
    for gradient, leaf in zip(gradients, leaves, strict=True):
        assert leaf.grad is not None
        torch.testing.assert_close(gradient[0], leaf.grad[0])


@pytest.mark.parametrize("backend", BACKENDS)
def test_nothing_overflows_at_the_near_plane(backend: str) -> None:
    places = torch.tensor([0.0, 1e-3, 1.0, 1e6, 1e30, 3e38])
    depths = torch.tensor([0.0, 1e-30, NEAR * 0.99, NEAR * 1.01, -NEAR])
    x, z = (grid.flatten() for grid in torch.meshgrid(places, depths, indexing="ij"))
    means = torch.stack([torch.cat([x, -x]), torch.cat([-x, x]), z.repeat(2)], -1)
    parameters = [p[:1].repeat(len(means), *(1,) * (p.dim() - 1)) for p in needle()]
    parameters[0] = means
    scene = (parameters, torch.eye(4)[None], intrinsics(), *SIZE)
    dtype = torch.float64 if backend == "reference" else torch.float32
    output, gradients = differentiate(backend, dtype, *scene, limits=BESIDE)
    seen = (means[:, 2] > NEAR) & (means[:, 0].abs() < NEAR)
    assert torch.equal(output.visible[0], seen) and bool(seen.any())
    assert torch.isfinite(output.image).all()
    for gradient in gradients:
        assert torch.isfinite(gradient).all() and not gradient[~seen].any()


def turned_disc(degrees: float, depth: float) -> list[Tensor]:
    """A disc before the camera, 0.01 thick and 0.5 wide, turned about y: at 90 it points at it."""
    half = np.radians(degrees) / 2
    quats = torch.tensor([[np.cos(half), 0.0, np.sin(half), 0.0]], dtype=torch.float32) * 3
    colour = torch.full((1, 1, 3), 1.0)
    means = torch.tensor([[0.0, 0.0, depth]])
    return [means, quats, torch.tensor([[0.5, 0.5, 0.01]]), torch.tensor([0.9]), colour]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0])
def test_what_reaches_behind_the_camera_is_left_out(
    backend: str, raw: bool, degrees: float
) -> None:
    """Standard deviations along the camera's axis count: a wall may be as near as it is thin."""
    turn = np.radians(degrees)
    sigma = float(np.hypot(0.01 * np.cos(turn), 0.5 * np.sin(turn)))
    for factor, seen in ((0.99, False), (1.01, True)):
        disc = turned_disc(degrees, factor * MIN_SIGMAS * sigma)
        if raw:
            disc[2], disc[3] = disc[2].log(), disc[3].logit()
        output = draw(backend, disc, limits=PICTURE_LIMITS, raw=raw)
        assert bool(output.visible.any()) == bool(output.alpha.any()) == seen
        assert draw(backend, disc, limits=NO_LIMITS, raw=raw).visible.any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_axis_is_the_cameras(backend: str) -> None:
    """A camera that looks along the world's x, at a disc that is wide in x and y."""
    disc = turned_disc(0.0, 0.0)
    view = torch.eye(4)[None].clone()
    view[0, :3, :3] = torch.tensor([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    for depth, seen in ((0.99, False), (1.01, True)):
        disc[0] = torch.tensor([[depth, 0.0, 0.0]])
        output = rasterize(*disc, view, intrinsics(), *SIZE, limits=BEHIND, backend=backend)
        assert bool(output.visible.any()) == seen


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_is_left_out_has_no_gradient(backend: str) -> None:
    both = zip(turned_disc(90.0, 0.5), turned_disc(10.0, 0.5), strict=True)
    parameters = [torch.cat(pair) for pair in both]
    dtype = torch.float64 if backend == "reference" else torch.float32
    scene = (parameters, torch.eye(4)[None], intrinsics(), *SIZE)
    output, gradients = differentiate(backend, dtype, *scene, limits=BEHIND)
    assert output.visible.tolist() == [[False, True]]
    for gradient in gradients:
        assert not gradient[0].any() and gradient[1].any()


@pytest.mark.parametrize("value", [-1.0, float("nan")])
@pytest.mark.parametrize("name", ["max_slope", "min_sigmas"])
def test_limits_are_not_negative(name: str, value: float) -> None:
    with pytest.raises(EngineError, match=name):
        Limits(**{name: value})


def test_limits_beyond_everything_change_no_bit() -> None:
    scene = (gaussians(300), torch.eye(4)[None], intrinsics(), *SIZE)
    wide = Limits(max_slope=1e9, min_sigmas=1e-9)
    outputs = [
        differentiate("cpu", torch.float32, *scene, limits=limits) for limits in (NO_LIMITS, wide)
    ]
    (plain, gradients), (limited, same) = outputs
    assert torch.equal(plain.image, limited.image) and torch.equal(plain.visible, limited.visible)
    assert all(torch.equal(a, b) for a, b in zip(gradients, same, strict=True))


def test_pictures_have_limits_and_consistency_has_none() -> None:
    """Consistency draws a training photo as training does."""
    means, quats, scales, opacities, sh = needle()
    raw = Gaussians(
        means=means,
        quats=quats,
        log_scales=scales.log(),
        logit_opacities=opacities.logit(),
        sh=sh,
    )
    camera = Camera(width=64, height=48, fx=FOCAL, fy=FOCAL, cx=30.0, cy=27.0)
    assert not render_view(raw, camera, np.eye(4)).image.any()
    assert rasterize_view(raw, camera, np.eye(4)).image.any()

    image = PosedImage(
        name="a.png",
        path=Path("a.png"),
        camera=camera,
        world_to_camera=np.eye(4),
        point_indices=np.zeros(0, dtype=np.int64),
    )
    around = OrientedBox(name="box", world_to_box=np.eye(4), half_extents=np.full(3, 9.0))
    assert consistent_across_views(raw, [image], [around], np.zeros((0, 3)), 1).all()
    (shown,) = blending_weights(raw, [(camera, np.eye(4))])
    (limited,) = blending_weights(raw, [(camera, np.eye(4))], limits=PICTURE_LIMITS)
    assert shown.total.any() and not limited.total.any()


@settings(
    max_examples=20,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(
    size=st.tuples(st.integers(9, 60), st.integers(9, 60)),
    focal=st.floats(0.15, 2.0),  # in widths: 147 to 28 degrees wide
    centre=st.tuples(st.floats(0.1, 0.9), st.floats(0.1, 0.9)),
    reach=st.floats(0.1, 1.5),
    seed=st.integers(0, 2**31),
)
def test_kernels_and_reference_leave_out_the_same(
    isa: str,
    size: tuple[int, int],
    focal: float,
    centre: tuple[float, float],
    reach: float,
    seed: int,
) -> None:
    """Slopes to twice the limit, Gaussians that large, two cameras."""
    generator = torch.Generator().manual_seed(seed)
    pinhole = intrinsics(focal * size[0], centre[0] * size[0], centre[1] * size[1])
    count = 40
    depth = torch.rand(count, 1, generator=generator) * 3 + 0.05
    slopes = (torch.rand(count, 2, generator=generator) * 4 - 2) * MAX_SLOPE
    parameters = gaussians(count, coefficients=4, seed=seed)
    parameters[0] = depth * torch.cat([slopes, torch.ones(count, 1)], dim=1)
    parameters[2] *= reach * depth / 0.13
    views = torch.eye(4).repeat(2, 1, 1)
    views[1, :3, 3] = torch.tensor([0.3, -0.2, 0.1])
    scene = (parameters, views, pinhole.repeat(2, 1, 1), *size)
    options = {"background": BACKGROUND, "limits": PICTURE_LIMITS}
    ours, truth, errors = render_both(*scene, **options)

    t = parameters[0] @ views[:, :3, :3].mT + views[:, None, :3, 3]
    slope = t[..., :2] / t[..., 2:]
    x = slope * pinhole[0, 0, 0] + pinhole[0, :2, 2]
    beside = (x < -0.01) | (x > torch.tensor(size) + 0.01)
    outside = (beside & (slope.abs() > 1.001 * MAX_SLOPE)).any(-1)
    axes = rotation_matrices(torch.nn.functional.normalize(parameters[1], dim=-1))
    along = (views[:, None, 2:3, :3] @ axes)[..., 0, :] * parameters[2]
    outside |= t[..., 2] < 0.999 * MIN_SIGMAS * along.norm(dim=-1)
    assert not (ours.visible & outside).any()
    assert torch.equal(ours.visible, truth.visible)
    assert largest_difference(ours.image, truth.image) < 1e-3
    _, single = differentiate("reference", torch.float32, *scene, **options)
    _, double = differentiate("reference", torch.float64, *scene, **options)
    limits = gradient_errors(single, double)
    for name, error in errors.items():
        assert error <= max(1e-4, 3 * limits[name]), (name, errors, limits)
    leaves = [p.clone().requires_grad_() for p in parameters]
    rasterize(*leaves, *scene[1:], limits=PICTURE_LIMITS, backend="cpu").image.sum().backward()
    for leaf in leaves:
        assert leaf.grad is not None and not leaf.grad[outside.all(0)].any()
