"""The rasterizer on gsplat's CUDA kernels, for float32 tensors on an NVIDIA GPU.

gsplat's model is that of `rasterize`: pixel centres at +0.5, quaternions wxyz of any length, the
same SH basis, 0.3 px^2 of blur, alpha between 1/255 and 0.999, the Jacobian inside the view widened
by 0.3. The differences (docs/cuda.md):

* A Gaussian is in the list of every tile that its bounding rectangle touches, also if its ellipse
  does not reach the tile: `visible` has a few more Gaussians, with zero gradients.
* A pixel stops before the Gaussian that would leave a transmittance below 1e-4.
* gsplat does not check for NaN and Inf, and has no `limits`. Here such Gaussians are removed
  after the projection, and their gradients set to zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..cuda import library
from ..errors import KernelError
from .culling import within
from .inputs import (
    FAINTEST,
    NEAR,
    TILE,
    Blur,
    RenderInputs,
    RenderOutput,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class ProjectedGaussians:
    """All N Gaussians projected to one camera; gsplat does not write rows of radius 0."""

    radii: Tensor  # (1, N, 2) int32 px, 0 for culled Gaussians
    means2d: Tensor  # (1, N, 2) px in the whole image
    depths: Tensor  # (1, N)
    conics: Tensor  # (1, N, 3)
    opacities: Tensor  # (1, N)
    colours: Tensor  # (1, N, 3)


@dataclass(frozen=True, kw_only=True, eq=False)
class Statistics:
    """Statistics that rendering adds up: fields of `RenderOutput`."""

    visible: Tensor  # (C, N) bool
    grad2d: Tensor  # (C, N)
    largest: Tensor | None  # (N,)
    sums: Tensor | None  # (N,)


def render(inputs: RenderInputs) -> RenderOutput:
    """Render all cameras; see `rasterize`.

    Raises:
        KernelError: tensors of another type, median depth, or gsplat cannot be used.
    """
    if any(p.dtype != torch.float32 for p in inputs.parameters):
        raise KernelError("rasterize: the gsplat backend takes float32 tensors only.")
    if inputs.with_depth == "median":
        raise KernelError("rasterize: the gsplat backend has no median depth: gsplat has none.")
    means = inputs.means.detach()
    cameras, count = len(inputs.viewmats), len(means)
    zeros = torch.zeros(cameras, count, device=means.device)
    statistics = Statistics(
        visible=torch.zeros_like(zeros, dtype=torch.bool),
        grad2d=zeros,
        largest=torch.zeros_like(means[:, 0]) if inputs.with_max_weight else None,
        sums=torch.zeros_like(means[:, 0]) if inputs.with_weight_sum else None,
    )
    left, top, right, bottom = inputs.tiles
    if count and right > left and bottom > top:
        frames = [_draw(inputs, c, statistics) for c in range(cameras)]
    else:
        frames = [_empty_frame(inputs)] * cameras
    image, alpha, depth = (_stack(part) for part in zip(*frames, strict=True))
    return RenderOutput(
        image=image,
        alpha=alpha,
        visible=statistics.visible,
        grad2d=statistics.grad2d,
        depth=depth if inputs.with_depth else None,
        max_weight=statistics.largest,
        weight_sum=statistics.sums,
    )


def _stack(parts: tuple[Tensor, ...]) -> Tensor:
    """As torch.stack, but a single part is not copied."""
    return parts[0][None] if len(parts) == 1 else torch.stack(parts)


def _empty_frame(inputs: RenderInputs) -> tuple[Tensor, Tensor, Tensor]:
    """Image, alpha and depth without Gaussians; to autograd the image is a function of them."""
    size = inputs.height, inputs.width
    image = inputs.background.expand(*size, 3) + sum(p[:0].sum() for p in inputs.parameters)
    blank = inputs.background.new_zeros(size)
    return image, blank, blank


def _draw(
    inputs: RenderInputs, camera: int, statistics: Statistics
) -> tuple[Tensor, Tensor, Tensor]:
    """Image (H, W, 3), alpha (H, W) and depth (H, W) of one camera; adds to the statistics."""
    gsplat = library.gsplat()
    splats = _project(gsplat, inputs, camera)
    _record_grad2d(splats.means2d, statistics.grad2d[camera], inputs)
    # The window is applied after the projection, which depends on the size of the whole image.
    left, top, right, bottom = inputs.tiles
    x0, y0 = left * TILE, top * TILE
    width, height = min(right * TILE, inputs.width) - x0, min(bottom * TILE, inputs.height) - y0
    means2d = splats.means2d
    if x0 or y0:
        means2d = torch.stack((means2d[..., 0] - x0, means2d[..., 1] - y0), dim=-1)
    grid: dict[str, Any] = {"tile_width": right - left, "tile_height": bottom - top}
    touched, pairs, ids = gsplat.isect_tiles(
        means2d=means2d, radii=splats.radii, depths=splats.depths, tile_size=TILE, **grid
    )
    offsets = gsplat.isect_offset_encode(isect_ids=pairs, n_images=1, **grid)
    mask = inputs.tile_mask
    colours, background = splats.colours, inputs.background
    if inputs.with_depth:
        colours = torch.cat([colours, splats.depths[..., None].detach()], dim=-1)
        background = torch.cat([background, background.new_zeros(1)])
    image, alpha = gsplat.rasterize_to_pixels(
        means2d=means2d,
        conics=splats.conics,
        colors=colours,
        opacities=splats.opacities,
        image_width=width,
        image_height=height,
        tile_size=TILE,
        isect_offsets=offsets,
        flatten_ids=ids,
        backgrounds=background[None],
        masks=None if mask is None else mask[None],
    )
    image, alpha = image[0], alpha.detach()[0, ..., 0]
    if mask is not None:  # gsplat does not write the alpha of other tiles
        drawn = mask.repeat_interleave(TILE, 0).repeat_interleave(TILE, 1)[:height, :width]
        alpha = torch.where(drawn, alpha, 0)
    depth = alpha
    if inputs.with_depth:
        depth = image[..., 3].detach() / torch.where(alpha > 0, alpha, 1)
        image = image[..., :3]
    statistics.visible[camera] = touched[0] > 0
    if statistics.largest is not None or statistics.sums is not None:
        _add_blending_weights(
            inputs, camera, splats, means2d, (offsets[0], ids), (x0, y0, width, height), statistics
        )
    place = slice(y0, y0 + height), slice(x0, x0 + width)
    return tuple(_placed(part, place, inputs) for part in (image, alpha, depth))  # type: ignore[return-value]


def _project(gsplat: Any, inputs: RenderInputs, camera: int) -> ProjectedGaussians:
    """Project and colour all Gaussians; remove those with NaN or Inf, or beyond the limits."""
    # Views have their own hooks, which zero the gradients of removed Gaussians.
    means, quats, scales, opacities, sh = (p.view_as(p) for p in inputs.parameters)
    small = (means, quats, scales, opacities)
    if inputs.raw:
        scales, opacities = scales.exp(), opacities.sigmoid()
    view = inputs.viewmats[camera].to(means)
    radii, means2d, depths, conics, _ = gsplat.fully_fused_projection(
        means=means,
        covars=None,
        quats=quats,
        scales=scales,
        viewmats=view[None],
        Ks=inputs.Ks[camera].to(means)[None],
        width=inputs.width,
        height=inputs.height,
        eps2d=inputs.blur.drawn,
        near_plane=NEAR,
        opacities=opacities,
    )
    with torch.no_grad():
        total = means2d.sum(-1) + conics.sum(-1) + depths + opacities
        drawn = (radii > 0).all(-1) & total.isfinite()  # (1, N)
        if inputs.limits.cull:
            drawn &= within(inputs, camera, means2d)
        pose = view.double()  # differences of large numbers lose digits
        eye = -(pose[:3, :3].T @ pose[:3, 3]).to(means)
    colours = gsplat.spherical_harmonics(
        degrees_to_use=inputs.sh_degree, dirs=means - eye, coeffs=sh, masks=drawn[0]
    )
    colours = (colours + 0.5).clamp(min=0.0)[None]
    with torch.no_grad():
        drawn = drawn & colours.sum(-1).isfinite()
        culled = ~drawn[0]
    for parameter in small:  # not sh: its gradient is already zero, as that of the colour is
        if parameter.requires_grad:
            parameter.register_hook(_zero_rows(culled))  # type: ignore[no-untyped-call]
    return ProjectedGaussians(
        radii=radii * drawn[..., None],
        means2d=means2d,
        depths=depths,
        conics=conics,
        opacities=_drawn_opacities(opacities, conics[0], inputs.blur)[None],
        colours=colours,
    )


def _drawn_opacities(opacities: Tensor, conics: Tensor, blur: Blur) -> Tensor:
    """(N,) opacities of what is drawn: drawn_opacity in kernels/geometry.h."""
    less = blur.drawn - blur.stored
    if not less:
        return opacities
    xx, xy, yy = conics.unbind(-1)  # of the inverse of the covariance
    # det(covariance - less I) / det(covariance)
    share = 1 - less * (xx + yy) + less * less * (xx * yy - xy * xy)
    return opacities * share.clamp(min=FAINTEST).sqrt()


def _zero_rows(mask: Tensor) -> Any:
    """A hook that sets the rows of a mask (N,) to zero in a gradient (N, ...)."""

    def hook(gradient: Tensor) -> Tensor:
        return gradient.masked_fill(mask.view(-1, *(1,) * (gradient.dim() - 1)), 0)

    return hook


def _record_grad2d(means2d: Tensor, grad2d: Tensor, inputs: RenderInputs) -> None:
    """Make `backward` write the scaled norm of dL / d(means2d) (1, N, 2) into `grad2d` (N,)."""
    if not means2d.requires_grad:
        return
    half_width, half_height = 0.5 * inputs.width, 0.5 * inputs.height

    def write(gradient: Tensor) -> None:
        x, y = gradient[0].unbind(-1)
        torch.hypot(x * half_width, y * half_height, out=grad2d)

    means2d.register_hook(write)  # type: ignore[no-untyped-call]


def _add_blending_weights(
    inputs: RenderInputs,
    camera: int,
    projected: ProjectedGaussians,
    means2d: Tensor,  # (1, N, 2) px from the window's corner
    lists: tuple[Tensor, Tensor],  # offsets of the tiles' lists, and the lists
    window: tuple[int, int, int, int],  # x0, y0, width, height in pixels
    statistics: Statistics,
) -> None:
    """Add one camera's blending weights to the statistics."""
    if not library.has_triton():
        raise KernelError(
            "Blending weights on the GPU need Triton, which is not installed.",
            "Run pip install triton (on Windows triton-windows), or use a strategy without"
            " contribution_every (joint), or --device cpu.",
        )
    from .gsplat_weights import TileLists, blending_weights

    x0, y0, width, height = window
    counts = inputs.pixel_weights
    if counts is not None:
        counts = counts[camera, y0 : y0 + height, x0 : x0 + width]
    blending_weights(
        means2d[0].detach(),
        projected.conics[0].detach(),
        projected.opacities[0].detach(),
        TileLists(
            offsets=lists[0], ids=lists[1], mask=inputs.tile_mask, width=width, height=height
        ),
        pixel_weights=counts,
        largest=statistics.largest,
        sums=statistics.sums,
    )


def _placed(part: Tensor, place: tuple[slice, slice], inputs: RenderInputs) -> Tensor:
    """A rendered rectangle in the whole image; around it is background (image) or zeros."""
    size = inputs.height, inputs.width
    if part.shape[:2] == size:
        return part
    whole = part.new_zeros(size) if part.dim() == 2 else inputs.background.expand(*size, 3).clone()
    whole[place] = part
    return whole
