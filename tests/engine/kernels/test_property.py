"""Random scenes: the kernels' step agrees with float64, and its bits do not depend on threads.

A step is projection, blending, L1 + SSIM against an 8-bit photo, and the gradient of that loss for
every parameter group; the truth is autograd of the plain torch forms in float64.

A scene follows from its number alone, so a failure can be repeated; `-m slow` takes many more.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from roigs_engine.kernels import library
from roigs_engine.rasterize import RenderOutput, rasterize, reference
from roigs_engine.rasterize.limits import NO_LIMITS, Limits
from roigs_engine.training.optimizer import VisibleAdam
from tests.engine.rasterize_cases import NAMES, gradient_errors, largest_difference
from tests.engine.training.adam_from_gradients import AdamFromGradients
from tests.engine.training.reference_loss import photo_loss

GRADIENT_TOLERANCE = 1e-4  # relative L2 per parameter group
IMAGE_TOLERANCE = 1e-3
THREADS = (1, 2, 3, 5)
LARGEST_LOGIT = 7.0
"""Opacities 0.001 to 0.999. Beyond it, float32 cannot hold 1 - sigmoid(logit), a factor of the
logit's gradient, to 1e-4: at 11 its own error is 2e-3."""
EXACT = Limits(min_transmittance=0.0)
"""By default the kernels give a Gaussian no gradient where its weight is below 1e-6. The truth has
it, which shows in a scene whose gradients are all small."""
FEW, MANY = range(24), range(24, 540)  # numbers of scenes
AT_A_LIMIT = 0.15
"""Share of the numbers of scenes that are drawn at an end of their range."""


@dataclass(frozen=True, kw_only=True)
class SceneKind:
    """The properties of a random scene; its numbers follow from this and the seed.

    Attributes:
        count: Gaussians.
        width, height: of the image.
        focal: (2,) fx and fy in image sides.
        centre: (2,) principal point in image sides.
        distance: of the camera from the middle of the cloud, whose standard deviation is 1.
        size: median standard deviation of a Gaussian.
        spread: standard deviation of the logarithm of sizes, within and among Gaussians.
        opacity: standard deviation of the logits, around 0.
        degree: of the spherical harmonics that are stored.
        used_degree: of those that are evaluated, as far as they are stored.
        raw: logarithms and logits go in.
        region: share of the image that is worked on (x0, y0, x1, y1), or None.
        seed: of everything random.
    """

    count: int
    width: int
    height: int
    focal: tuple[float, float]
    centre: tuple[float, float]
    distance: float
    size: float
    spread: float
    opacity: float
    degree: int
    used_degree: int
    raw: bool
    region: tuple[float, float, float, float] | None
    seed: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """The arguments of `rasterize` in float32, and the photo."""

    parameters: list[Tensor]
    view: Tensor  # (1, 4, 4)
    intrinsics: Tensor  # (1, 3, 3)
    width: int
    height: int
    sh_degree: int
    raw: bool
    background: Tensor  # (3,)
    region: tuple[int, int, int, int] | None
    photo: Tensor  # (H, W, 3) uint8


def kind_of(number: int, most: int = 300, largest: int = 70) -> SceneKind:
    """The scene of a number, with at most so many Gaussians and pixels a side."""
    random = np.random.default_rng(number)

    def between(low: float, high: float) -> float:
        if random.random() < AT_A_LIMIT:
            return float(random.choice([low, high]))
        return float(random.uniform(low, high))

    def pair(low: float, high: float) -> tuple[float, float]:
        return between(low, high), between(low, high)

    return SceneKind(
        count=int(random.choice([0, 1])) if random.random() < 0.1 else round(between(2, most)),
        # On an image of a pixel or two, all Gaussians lie behind one another. The kernels get what
        # is behind a Gaussian as a difference from the finished pixel, so that the deepest of many
        # opaque layers lose digits: up to 8e-4 of the rotations' gradient there.
        width=round(between(8, largest)),
        height=round(between(8, largest)),
        focal=pair(0.6, 2.0),
        centre=pair(0.2, 0.8),
        distance=between(0.0, 6.0),  # 0: in the middle of the cloud
        size=math.exp(between(math.log(1e-3), math.log(0.3))),
        # 0 would be spheres, whose rotation has no gradient to be relative to.
        spread=between(0.1, 1.2),
        opacity=between(0.0, 5.0),
        degree=int(random.integers(4)),
        used_degree=int(random.integers(4)),
        raw=bool(random.integers(2)),
        region=None if random.integers(2) else (*pair(-0.2, 1.2), *pair(-0.2, 1.2)),
        seed=int(random.integers(2**31)),
    )


def scene_of(kind: SceneKind) -> Scene:
    generator = torch.Generator().manual_seed(kind.seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    n, (fx, fy), (cx, cy) = kind.count, kind.focal, kind.centre
    scales = math.log(kind.size) + kind.spread * normal(n, 3)
    opacities = (kind.opacity * normal(n)).clamp(-LARGEST_LOGIT, LARGEST_LOGIT)
    if not kind.raw:
        scales, opacities = scales.exp(), opacities.sigmoid()
    rotation, _ = torch.linalg.qr(normal(3, 3).double())
    view = torch.eye(4, dtype=torch.float64)
    view[:3, :3] = rotation * torch.det(rotation)  # det = 1: no mirroring
    view[2, 3] = kind.distance
    sides = torch.tensor([kind.width, kind.height])
    region = None
    if kind.region is not None:
        corners = torch.tensor(kind.region).reshape(2, 2).sort(dim=0).values * sides
        x0, y0, x1, y1 = (int(v) for v in corners.flatten())
        region = (x0, y0, x1, y1)
    side = max(kind.width, kind.height)
    return Scene(
        parameters=[
            normal(n, 3),
            2.0 * normal(n, 4),
            scales,
            opacities,
            0.4 * normal(n, (kind.degree + 1) ** 2, 3),
        ],
        view=view.float()[None],
        intrinsics=torch.tensor(
            [[[fx * side, 0, cx * kind.width], [0, fy * side, cy * kind.height], [0, 0, 1]]]
        ),
        width=kind.width,
        height=kind.height,
        sh_degree=min(kind.degree, kind.used_degree),
        raw=kind.raw,
        background=torch.rand(3, generator=generator),
        region=region,
        photo=torch.randint(
            0, 256, (kind.height, kind.width, 3), generator=generator, dtype=torch.uint8
        ),
    )


def step(
    scene: Scene,
    leaves: list[Tensor],
    backend: str,
    optimizer: VisibleAdam | None = None,
    limits: Limits = NO_LIMITS,
) -> RenderOutput:
    """Renders the scene with these parameters, in their type, and differentiates the loss."""
    dtype = leaves[0].dtype
    output = rasterize(
        *leaves,
        scene.view.to(dtype),
        scene.intrinsics.to(dtype),
        scene.width,
        scene.height,
        sh_degree=scene.sh_degree,
        raw=scene.raw,
        background=scene.background,
        mask=scene.region,
        limits=limits,
        with_max_weight=True,
        backward_step=None if optimizer is None else optimizer.backward_step,
        backend=backend,
    )
    photo_loss(output.image, scene.photo, backend=backend).loss.backward()
    return output


def gradients(scene: Scene, backend: str, dtype: torch.dtype) -> tuple[Tensor, list[Tensor]]:
    """The scene's image, and the gradients of its loss by `NAMES`."""
    leaves = [p.to(dtype, copy=True).requires_grad_() for p in scene.parameters]
    image = step(scene, leaves, backend, limits=EXACT).image
    return image, [leaf.grad for leaf in leaves if leaf.grad is not None]


def agrees_with_float64(kind: SceneKind) -> None:
    scene = scene_of(kind)
    image, ours = gradients(scene, "cpu", torch.float32)
    true_image, truth = gradients(scene, "reference", torch.float64)
    if largest_difference(image, true_image) >= IMAGE_TOLERANCE:
        # A pixel may be as in the picture on either side of the jump, see `conditioning`.
        pictures = [true_image, *(moved for moved, _ in beside_alpha_min(scene))]
        nearest = torch.stack([(image - each).abs() for each in pictures]).min(dim=0).values
        assert nearest.max() < IMAGE_TOLERANCE
    errors = gradient_errors(ours, truth)
    if max(errors.values()) > GRADIENT_TOLERANCE:
        limits = conditioning(scene, truth)
        for name, error in errors.items():
            # a jump, and the usual rounding beside it
            assert error <= GRADIENT_TOLERANCE + limits[name], (kind, name, errors, limits)


def conditioning(scene: Scene, truth: list[Tensor]) -> dict[str, float]:
    """Allowed error of float32 in an ill-conditioned scene; about one in 500 is.

    A gradient may cancel to nearly nothing (a group of one Gaussian): torch's float32 shows that.
    Or an alpha lies at ALPHA_MIN to the last bits, where the picture jumps: then the truth itself
    changes with the side on which that alpha is taken to be.
    """
    _, single = gradients(scene, "reference", torch.float32)
    limits = [3 * error for error in gradient_errors(single, truth).values()]
    for _, moved in beside_alpha_min(scene):
        limits = list(map(max, limits, gradient_errors(moved, truth).values()))
    return dict(zip(NAMES, limits, strict=True))


def beside_alpha_min(scene: Scene) -> Iterator[tuple[Tensor, list[Tensor]]]:
    """The true image and gradients with the least alpha a little smaller, and a little larger."""
    for shift in (-1e-5, 1e-5):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(reference, "ALPHA_MIN", reference.ALPHA_MIN * (1 + shift))
            yield gradients(scene, "reference", torch.float64)


def test_step_agrees_with_float64(isa: str) -> None:
    for number in FEW:
        agrees_with_float64(kind_of(number))


@pytest.mark.slow
def test_many_steps_agree_with_float64(isa: str) -> None:
    for number in MANY:
        agrees_with_float64(kind_of(number))


def bits_of_training(scene: Scene, threads: int, *, fused: bool) -> dict[str, bytes]:
    """All that two training steps with so many threads leave behind."""
    library.set_threads(threads)
    leaves = [p.clone() for p in scene.parameters]
    parameters = {n: (leaf, 0.01) for n, leaf in zip(NAMES, leaves, strict=True)}
    adam = VisibleAdam(parameters) if fused else AdamFromGradients(parameters)
    adam.row_rates = 1.0 + (torch.arange(len(leaves[0])) // 7 % 3)
    left: dict[str, Tensor] = {}
    for k in range(2):
        output = step(scene, leaves, "cpu", adam if fused else None)
        for name in ("image", "alpha", "visible", "grad2d", "max_weight"):
            left[f"{name} {k}"] = getattr(output, name)
        if isinstance(adam, AdamFromGradients):
            for name, leaf in zip(NAMES, leaves, strict=True):
                assert leaf.grad is not None
                left[f"gradient {name} {k}"] = leaf.grad.clone()
            adam.step(output.visible[0])
    for name, leaf in adam.parameters.items():
        left |= {name: leaf, f"m {name}": adam.exp_avg[name], f"v {name}": adam.exp_avg_sq[name]}
    assert adam.step_count == 2
    return {name: t.detach().contiguous().numpy().tobytes() for name, t in left.items()}


def has_the_same_bits(kind: SceneKind) -> None:
    scene = scene_of(kind)
    alone = bits_of_training(scene, THREADS[0], fused=False)
    for threads in THREADS[1:]:
        assert bits_of_training(scene, threads, fused=False) == alone, f"{threads} threads"
    for threads in THREADS:
        for name, bits in bits_of_training(scene, threads, fused=True).items():
            assert bits == alone[name], f"{name}: {threads} threads, fused"


# Larger scenes here: small ones are too little work to be divided.
LARGER = {"most": 8_000, "largest": 128}


def test_same_bits_at_any_number_of_threads(isa: str) -> None:
    for number in FEW[::4]:
        has_the_same_bits(kind_of(number, **LARGER))


@pytest.mark.slow
def test_same_bits_at_any_number_of_threads_in_many_scenes(isa: str) -> None:
    for number in MANY:
        has_the_same_bits(kind_of(number, **LARGER))
