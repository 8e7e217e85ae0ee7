"""The interface of all backends: constants, checked inputs, output."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor

from ..cuda.pair_buffers import PairBuffer
from ..errors import EngineError
from ..formats.targets import BLUR
from ..gpu.resident import Resident
from ..kernels import bindings
from .light import to_linear, to_srgb
from .limits import Limits

TILE = 16  # side of a pixel tile; culling, binning and masks work in whole tiles
LONGEST_SIDE = 1 << 16  # px of an image: up to this, float32 positions have steps of 1/128 px
NEAR = 0.01  # Gaussians whose centre is nearer to the camera plane (scene units) are culled
ALPHA_MIN = 1.0 / 255.0  # smaller contributions are skipped: 8-bit output would not show them
ALPHA_MAX = 0.999  # keeps 1 / (1 - alpha) in the gradient finite
FAINTEST = (ALPHA_MIN / 2) ** 2
"""Least ratio of squared areas; Gaussians below it are not drawn. It keeps the root's gradient
finite."""
FRUSTUM_MARGIN = 0.3
"""The Jacobian is evaluated inside the view, widened by this share of its half width."""
PLANE_BLUR = 0.01
"""Added to the 2D covariance's diagonal, px^2, to find a Gaussian's plane (`Surface`). It keeps the
planes of line-like Gaussians finite."""
STEEPEST = 1e30  # stands for no limit of slopes; in pixels, it is still a float32
SH_SIZES = (1, 4, 9, 16)  # coefficients per colour for degrees 0 to 3

Depth = bool | Literal["median"]
"""Whether to return a depth, and which: True is the mean."""


class Blur(NamedTuple):
    """Blur added to the diagonal of the 2D covariance, px^2 of the picture.

    With the blur `stored`, a Gaussian has its stored opacity. With `drawn`, it is larger, and its
    opacity is lower by the same factor, so that its integral is the same.
    """

    drawn: float  # the whole blur
    stored: float


@dataclass(frozen=True)
class BackwardStep:
    """An optimizer step that the backward pass takes instead of returning gradients.

    It is the rasterizer's only interface to the optimizer.

    Attributes:
        tensors: those that the step updates, in the order of `rasterize`'s first five arguments.
        take: takes the step with a kernel, which gets the address of a `bindings.Adam` and returns
            the number of rows skipped because of NaN or Inf gradients.
        pair_buffer: buffer for the view's pairs on a GPU, to avoid waiting for it; None to wait.
        resident: the tensors on the GPU, if the `gpu` backend keeps them there; None if it does
            not.
    """

    tensors: tuple[Tensor, ...]
    take: Callable[[Callable[[Any], int | Tensor]], object]
    pair_buffer: PairBuffer | None = None
    resident: Resident | None = None


class Surface(NamedTuple):
    """Depths and normals of C pictures, all with gradients; `median`'s only to its own Gaussian.

    A Gaussian's plane has its points of highest density along rays, with rays parallel to the one
    through its centre (RaDe-GS, Zhang et al. 2024, sec. 3.2). So the plane's depth is affine in the
    pixel: with J W R S = U (2, 3) and the camera's z axis in the Gaussian's frame, w = R_z S (3,),
    it changes by w U^T (U U^T)^-1 per pixel. The plane's normal points to the camera.
    """

    depth: Tensor  # (C, H, W) along z, sum(w z) / sum(w) with z of the planes; 0 where empty
    median: Tensor  # (C, H, W) of the Gaussian that leaves at most half of the light; 0: none does
    normal: Tensor  # (C, H, W, 3) camera frame, sum(w n): its length is at most alpha

    @classmethod
    def of(cls, planes: Tensor, alpha: Tensor) -> Surface:
        """Make it from (C, 5, H, W) sum(w z), the median and sum(w n), and alpha (C, H, W)."""
        depth, median, *normal = planes.unbind(1)
        mean = depth / torch.where(alpha > 0, alpha, 1.0)
        return cls(mean, median, torch.stack(normal, dim=-1))


@dataclass(frozen=True)
class RenderOutput:
    """The output of `rasterize` for C cameras and N Gaussians.

    Only `image` has a gradient; with a `surface`, that and `alpha` have one, too.

    H and W are those of the window, if there is one. `grad2d` is zero until `backward()` has run.
    Then it is |dL / d(projected centre)| with x scaled by width / 2 and y by height / 2: 3DGS's
    criterion for densification. `depth` is along the camera's axis, 0 without a Gaussian. It is the
    mean sum(w z) / sum(w), or the median: the depth of the Gaussian at which the weights
    w = alpha * T, added front to back, reach half of their sum.
    """

    image: Tensor  # (C, H, W, 3) sRGB values, background included
    alpha: Tensor  # (C, H, W) 1 - the transmittance behind the last Gaussian
    visible: Tensor  # (C, N) bool, True if the Gaussian reaches an active tile
    grad2d: Tensor  # (C, N) float32
    depth: Tensor | None  # (C, H, W)
    max_weight: Tensor | None  # (N,) largest weight of the Gaussian in any pixel
    weight_sum: Tensor | None  # (N,) over all cameras' pixels, each times its `pixel_weights`
    surface: Surface | None

    def cut(self, window: tuple[int, int, int, int]) -> RenderOutput:
        """Return the part of whole images in a window; itself if the window is the whole."""
        left, top, right, bottom = window
        if self.alpha.shape[1:] == (bottom - top, right - left):
            return self  # even a full slice would be copied in the backward pass
        columns, rows = slice(left, right), slice(top, bottom)
        return replace(
            self,
            image=self.image[:, rows, columns],
            alpha=self.alpha[:, rows, columns],
            depth=None if self.depth is None else self.depth[:, rows, columns],
            surface=None
            if self.surface is None
            else Surface(*(each[:, rows, columns] for each in self.surface)),
        )

    def in_srgb(self, *, linear_light: bool) -> RenderOutput:
        """Return the output with an image in sRGB values, converted from `linear_light` if set."""
        return replace(self, image=to_srgb(self.image)) if linear_light else self


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderInputs:
    """The arguments of `rasterize` after its checks; all tensors on one device."""

    parameters: tuple[Tensor, Tensor, Tensor, Tensor, Tensor]  # the first five arguments
    viewmats: Tensor  # (C, 4, 4) world_to_camera
    Ks: Tensor  # (C, 3, 3)
    width: int
    height: int
    sh_degree: int
    raw: bool
    linear_light: bool
    limits: Limits
    background: Tensor  # (3,)
    with_depth: Depth
    with_max_weight: bool
    with_weight_sum: bool
    with_surface: bool
    pixel_weights: Tensor | None  # (C, H, W)
    tiles: tuple[int, int, int, int]  # first column, first row, end column, end row
    tile_mask: Tensor | None  # (rows, columns) bool, active tiles in this rectangle; None for all
    window: tuple[int, int, int, int]  # px, area of images; for cuda all, see `RenderOutput.cut`
    blur: Blur
    backward_step: BackwardStep | None  # None: the backward pass returns gradients

    @property
    def means(self) -> Tensor:
        """(N, 3) centres."""
        return self.parameters[0]

    @property
    def is_trained(self) -> bool:
        """Whether there may be a backward pass."""
        return any(parameter.requires_grad for parameter in self.parameters)

    def settle(self) -> None:
        """Copy the parameters back, if the `gpu` backend has kept them on the GPU."""
        if self.backward_step is not None and self.backward_step.resident is not None:
            self.backward_step.resident.settle()

    def fill(self, camera: bindings.Camera, c: int) -> None:
        """Set the fields of camera `c` that the kernels of all backends share."""
        camera.blur[:] = self.blur
        camera.max_slope = min(self.limits.max_slope, STEEPEST)
        camera.min_sigmas = self.limits.min_sigmas
        camera.min_transmittance = self.limits.min_transmittance
        camera.size[:] = [self.width, self.height]
        camera.tiles[:] = self.tiles


def check_inputs(
    parameters: tuple[Tensor, Tensor, Tensor, Tensor, Tensor],
    viewmats: Tensor,  # (C, 4, 4)
    Ks: Tensor,  # (C, 3, 3)
    width: int,
    height: int,
) -> None:
    """Raise EngineError unless shapes, types and devices of the arguments fit together."""
    means, quats, scales, opacities, sh = parameters
    n, cameras = means.shape[0] if means.ndim else -1, viewmats.shape[0] if viewmats.ndim else -1
    k = sh.shape[1] if sh.ndim == 3 else -1
    wanted = {
        "means": (means, (n, 3)),
        "quats": (quats, (n, 4)),
        "scales": (scales, (n, 3)),
        "opacities": (opacities, (n,)),
        "sh": (sh, (n, k, 3)),
        "viewmats": (viewmats, (cameras, 4, 4)),
        "Ks": (Ks, (cameras, 3, 3)),
    }
    for name, (tensor, shape) in wanted.items():
        if tuple(tensor.shape) != shape:
            raise EngineError(
                f"rasterize: {name} has shape {tuple(tensor.shape)}, expected {shape}."
            )
        if not tensor.is_floating_point() or tensor.device != means.device:
            raise EngineError(
                f"rasterize: {name} is {tensor.dtype} on {tensor.device}.",
                f"Pass floating point tensors on one device ({means.device}).",
            )
    if k not in SH_SIZES:
        raise EngineError(f"rasterize: sh has {k} coefficients per colour, not one of {SH_SIZES}.")
    if width < 1 or height < 1:
        raise EngineError(f"rasterize: the image size {width}x{height} is not positive.")
    if max(width, height) > LONGEST_SIDE:
        raise EngineError(
            f"rasterize: the image size {width}x{height} is too large.",
            f"Render at most {LONGEST_SIDE} pixels per side.",
        )


def check_backward_step(
    step: BackwardStep | None, parameters: tuple[Tensor, ...], cameras: int, backend: str
) -> None:
    """Raise EngineError unless a backward pass can take this step; None is valid."""
    if step is None:
        return
    trained = step.tensors
    if len(trained) != len(parameters) or any(
        a is not b for a, b in zip(trained, parameters, strict=True)
    ):
        raise EngineError(
            "rasterize: the backward step's tensors are not the tensors to render.",
            "Pass the optimizer's tensors, in the order of rasterize's arguments.",
        )
    if cameras != 1 or backend not in ("cpu", "cuda", "gpu"):
        raise EngineError(
            f"rasterize: no backward step with {cameras} cameras on the {backend} backend.",
            "Pass one camera and float32 tensors, or call the optimizer's step.",
        )


def checked_pixel_weights(
    pixel_weights: Tensor | None, with_weight_sum: bool, shape: tuple[int, int, int], like: Tensor
) -> Tensor | None:
    """Return the weights in `like`'s type and device; EngineError for wrong or unused weights."""
    if pixel_weights is None:
        return None
    if not with_weight_sum:
        raise EngineError("rasterize: pixel_weights without with_weight_sum have no effect.")
    if tuple(pixel_weights.shape) != shape:
        raise EngineError(
            f"rasterize: pixel_weights has shape {tuple(pixel_weights.shape)}, expected {shape}."
        )
    return pixel_weights.detach().to(like)


def checked_depth(with_depth: Depth) -> Depth:
    """Return the kind of depth; EngineError if it is unknown."""
    if isinstance(with_depth, str) and with_depth != "median":
        raise EngineError(f"rasterize: with_depth is {with_depth!r}, not a bool or 'median'.")
    return with_depth if with_depth == "median" else bool(with_depth)


def blur_of(pixel_size: float, antialiased: bool, blur: float = BLUR) -> Blur:
    """Return the blur of pixels whose side is `pixel_size` pixels of the whole photo.

    The photo's pixels have `blur`; n x n of them, evenly spread over a square of side 1, have a
    variance of (1 - 1/n^2) / 12 in it. In other words: of `blur`, 1/12 is the pixel itself, which
    averages over its square. The rest belongs to the photo, for any pixels of the picture. So a
    part of a pixel has the photo's blur, but averages over less.

    With anti-aliasing, a Gaussian has its stored opacity where it is much larger than a pixel
    (Mip-Splatting, Yu et al. 2024, sec. 5.2). Without it, it has this opacity in the whole photo.
    EngineError if the size is not positive.
    """
    if not 0 < pixel_size < math.inf:
        raise EngineError(f"rasterize: pixel_size {pixel_size} is not a positive number.")
    photo = blur / pixel_size**2
    return Blur(drawn=photo + (1 - 1 / pixel_size**2) / 12, stored=0.0 if antialiased else photo)


def used_sh_degree(coefficients: int, sh_degree: int | None) -> int:
    """Return the SH degree to evaluate: the given one, or that of all `coefficients` per colour."""
    stored = SH_SIZES.index(coefficients)
    if sh_degree is None:
        return stored
    if not 0 <= sh_degree <= stored:
        raise EngineError(f"rasterize: sh_degree {sh_degree} is not in 0..{stored}.")
    return sh_degree


def background_colour(
    background: Tensor | None, like: Tensor, *, linear_light: bool = False
) -> Tensor:
    """Return the (3,) background, or its light, in `like`'s type and device; black for None."""
    if background is None:
        return torch.zeros(3, dtype=like.dtype, device=like.device)
    if tuple(background.shape) != (3,):
        raise EngineError(f"rasterize: background has shape {tuple(background.shape)}, not (3,).")
    background = background.to(dtype=like.dtype, device=like.device)
    return to_linear(background) if linear_light else background
