"""The reference backend in plain torch: slow, differentiable, easy to read.

It blends every Gaussian into every pixel, without an early stop, in the dtype of `means`. The tests
compare the compiled backends with it in float64. Sections and equations: 3DGS (Kerbl et al. 2023),
EWA splatting (Zwicker et al. 2001).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..model.rotations import rotation_matrices
from .inputs import (
    ALPHA_MAX,
    ALPHA_MIN,
    FAINTEST,
    FRUSTUM_MARGIN,
    NEAR,
    PLANE_BLUR,
    TILE,
    Blur,
    RenderInputs,
    RenderOutput,
    Surface,
)
from .light import to_linear

PIXELS_AT_ONCE = 1 << 14
"""Pixels blended at once; limits the size of the (pixels, Gaussians) intermediates."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ProjectedGaussians:
    """The V Gaussians visible to one camera, front to back."""

    index: Tensor  # (V,) row of the input
    mean2d: Tensor  # (V, 2) px
    covariance: Tensor  # (V, 3) xx, xy, yy in px^2, blur added
    opacity: Tensor  # (V,)
    colour: Tensor  # (V, 3)
    depth: Tensor  # (V,)
    slope: Tensor  # (V, 2) change of its plane's depth per pixel, see `Surface`
    normal: Tensor  # (V, 3) of the plane, camera frame


def render(inputs: RenderInputs) -> RenderOutput:
    """Render all cameras; see `rasterize`."""
    means = inputs.means
    cameras, n = inputs.viewmats.shape[0], means.shape[0]
    image, alpha, depth, planes = [], [], [], []
    visible = torch.zeros(cameras, n, dtype=torch.bool, device=means.device)
    grad2d = torch.zeros(cameras, n, dtype=torch.float32, device=means.device)
    max_weight, weight_sum = means.new_zeros(n), means.new_zeros(n)
    for c in range(cameras):
        splats = project(inputs, c)
        visible[c, splats.index] = True
        record_grad2d(splats, grad2d[c], inputs.width, inputs.height)
        colours, opacity, depths, largest, sums, surface = blend(inputs, splats, c)
        image.append(colours)
        alpha.append(opacity)
        depth.append(depths)
        planes.append(surface)
        max_weight[splats.index] = torch.maximum(max_weight[splats.index], largest)
        weight_sum[splats.index] += sums
    # zero, but a function of the parameters, so `backward` also works if no Gaussian is visible
    nothing = sum(p[:0].sum() for p in inputs.parameters)
    opacities = torch.stack(alpha)
    shown = Surface.of(torch.stack(planes) + nothing, opacities) if inputs.with_surface else None
    return RenderOutput(
        image=torch.stack(image) + nothing,
        alpha=opacities if inputs.with_surface else opacities.detach(),
        visible=visible,
        grad2d=grad2d,
        depth=torch.stack(depth) if inputs.with_depth else None,
        max_weight=max_weight if inputs.with_max_weight else None,
        weight_sum=weight_sum if inputs.with_weight_sum else None,
        surface=shown,
    )


def project(inputs: RenderInputs, camera: int) -> ProjectedGaussians:
    """Project all Gaussians and keep those that reach a tile, ordered by depth."""
    with torch.no_grad():
        everything = torch.arange(inputs.means.shape[0], device=inputs.means.device)
        fields = project_all(inputs, camera, everything)
        usable = (fields[4] > NEAR) & (fields[2] > ALPHA_MIN)
        usable &= within(inputs, camera, fields[0])
        for field in fields:
            usable &= torch.isfinite(field if field.ndim == 1 else field.sum(dim=1))
        index = usable.nonzero()[:, 0]
        mean2d, covariance, opacity = (f[index] for f in fields[:3])
        size = (inputs.width, inputs.height)
        tiles = active_tile_positions(inputs)
        index = index[reaches_a_tile(mean2d, covariance, opacity, tiles, size)]
        index = index[torch.sort(fields[4][index], stable=True).indices]
    # Only the kept rows are projected again with gradients: a culled row's NaN or Inf times a zero
    # gradient would be NaN in the backward pass.
    mean2d, covariance, opacity, colour, depth, slope, normal = project_all(inputs, camera, index)
    return ProjectedGaussians(
        index=index,
        mean2d=mean2d,
        covariance=covariance,
        opacity=opacity,
        colour=colour,
        depth=depth,
        slope=slope,
        normal=normal,
    )


def within(inputs: RenderInputs, camera: int, means2d: Tensor) -> Tensor:
    """(..., N) bool: which Gaussians the limits keep; `means2d` (..., N, 2) are projected centres.

    Call it without gradients.
    """
    x, y = means2d.unbind(-1)
    (fx, _, cx), (_, fy, cy), _ = inputs.Ks[camera].tolist()
    far_x, far_y = inputs.limits.max_slope * fx, inputs.limits.max_slope * fy
    inside = (x > min(0, cx - far_x)) & (x < max(inputs.width, cx + far_x))
    inside &= (y > min(0, cy - far_y)) & (y < max(inputs.height, cy + far_y))
    means, quats, scales, _, _ = inputs.parameters
    axis = inputs.viewmats[camera, 2].to(means)
    axes = rotation_matrices(quats / quats.norm(dim=-1, keepdim=True))
    sigma = (axis[:3] @ axes * (scales.exp() if inputs.raw else scales)).norm(dim=-1)
    kept: Tensor = inside & (means @ axis[:3] + axis[3] > inputs.limits.min_sigmas * sigma)
    return kept


def project_all(inputs: RenderInputs, camera: int, index: Tensor) -> tuple[Tensor, ...]:
    """Return mean2d, covariance, opacity, colour, depth, slope and normal of V rows."""
    means, quats, scales, opacities, sh = (p[index] for p in inputs.parameters)
    if inputs.raw:
        scales, opacities = scales.exp(), opacities.sigmoid()
    view, K = inputs.viewmats[camera].to(means), inputs.Ks[camera].to(means)
    rotation, translation = view[:3, :3], view[:3, 3]
    t = means @ rotation.T + translation  # (V, 3) camera frame
    mean2d = (t[:, :2] / t[:, 2:]) * K.diagonal()[:2] + K[:2, 2]
    M = (
        rotation_matrices(quats / quats.norm(dim=-1, keepdim=True)) * scales[:, None, :]
    )  # (V, 3, 3); Sigma = M M^T, 3DGS eq. 6
    J = jacobian(t, K, inputs.width, inputs.height)
    U = J @ rotation @ M  # (V, 2, 3)
    sharp = torch.stack(
        [(U[:, 0] ** 2).sum(-1), (U[:, 0] * U[:, 1]).sum(-1), (U[:, 1] ** 2).sum(-1)], dim=-1
    )  # Sigma' = J W Sigma W^T J^T, 3DGS eq. 5
    covariance = sharp + sharp.new_tensor([inputs.blur.drawn, 0.0, inputs.blur.drawn])
    opacities = opacities * drawn_share(U, inputs.blur)
    eye = -rotation.T @ translation
    direction = torch.nn.functional.normalize(means - eye, dim=-1, eps=0.0)
    used = (inputs.sh_degree + 1) ** 2
    colour = torch.einsum("vk,vkc->vc", sh_basis(direction)[:, :used], sh[:, :used])
    colour = (colour + 0.5).clamp(min=0.0)
    if inputs.linear_light:
        colour = to_linear(colour)
    return mean2d, covariance, opacities, colour, t[:, 2], *plane(J, U, rotation[2] @ M)


def plane(J: Tensor, U: Tensor, w: Tensor) -> tuple[Tensor, Tensor]:
    """Return slope (V, 2) and normal (V, 3) of planes; J and U = J W R S (V, 2, 3), w (V, 3).

    See `Surface`. The normal m is orthogonal to the steps in the plane from pixel to pixel, and
    m . r = -1 for the ray r = (x / z, y / z, 1) through the centre.
    """
    # Solve (U U^T + b I) slope = U w; the determinant as in `drawn_share`, for needles, too.
    first, second = U[:, 0], U[:, 1]
    x, y = (U @ w[:, :, None])[..., 0].unbind(-1)
    xx, yy = (row.square().sum(-1) + PLANE_BLUR for row in (first, second))
    xy = (first * second).sum(-1)
    det = torch.linalg.cross(first, second).square().sum(-1)
    det = det + PLANE_BLUR * (xx + yy) - PLANE_BLUR**2
    slope = torch.stack([yy * x - xy * y, xx * y - xy * x], dim=-1) / det[:, None]
    per_depth = J.diagonal(dim1=-2, dim2=-1)  # focal / z
    m, ray = per_depth * slope, -J[:, :, 2] / per_depth
    normal = torch.cat([m, -1 - (m * ray).sum(-1, keepdim=True)], dim=-1)
    return slope, torch.nn.functional.normalize(normal, dim=-1)


def drawn_share(U: Tensor, blur: Blur) -> Tensor:
    """(V,) drawn opacity divided by stored opacity of Gaussians with J W R S = U (V, 2, 3)."""
    # det(U U^T + b I) = |U0 x U1|^2 + b tr(U U^T) + b^2: xx yy - xy^2 would cancel for needles
    area2 = torch.linalg.cross(U[:, 0], U[:, 1]).square().sum(-1)
    trace = U.square().sum((-2, -1))
    stored, drawn = (area2 + b * trace + b * b for b in (blur.stored, blur.drawn))
    share: Tensor = (stored / drawn).clamp(min=FAINTEST).sqrt()
    return share


def jacobian(t: Tensor, K: Tensor, width: int, height: int) -> Tensor:
    """(V, 2, 3) Jacobian of the pinhole projection at camera-frame points t (V, 3).

    Far outside the view the linearisation explodes; as in 3DGS, it is taken at the nearest point
    of the view widened by FRUSTUM_MARGIN (on each side of the principal point, as in gsplat).
    """
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    z = t[:, 2]
    margin_x, margin_y = FRUSTUM_MARGIN * 0.5 * width / fx, FRUSTUM_MARGIN * 0.5 * height / fy
    x = z * (t[:, 0] / z).clamp(-(cx / fx + margin_x), (width - cx) / fx + margin_x)
    y = z * (t[:, 1] / z).clamp(-(cy / fy + margin_y), (height - cy) / fy + margin_y)
    zero = torch.zeros_like(z)
    rows = [fx / z, zero, -fx * x / z**2, zero, fy / z, -fy * y / z**2]
    return torch.stack(rows, dim=-1).reshape(-1, 2, 3)


def sh_basis(direction: Tensor) -> Tensor:
    """(V, 16) real spherical harmonics up to degree 3 at unit vectors (V, 3), signs as in 3DGS."""
    x, y, z = direction.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    terms = [
        torch.full_like(x, 0.28209479177387814),
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy),
        0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3 * yy),
    ]
    return torch.stack(terms, dim=-1)


def determinant(covariance: Tensor) -> Tensor:
    """(V,) determinants of covariances (V, 3)."""
    xx, xy, yy = covariance.unbind(-1)
    return xx * yy - xy * xy


def exponent(covariance: Tensor, d: Tensor) -> Tensor:
    """1/2 d^T Sigma'^-1 d for covariances (V, 3) and offsets d (..., V, 2)."""
    xx, xy, yy = covariance.unbind(-1)
    dx, dy = d.unbind(-1)
    return 0.5 * (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / determinant(covariance)


def reaches_a_tile(
    mean2d: Tensor,  # (V, 2)
    covariance: Tensor,  # (V, 3)
    opacity: Tensor,  # (V,)
    tiles: Tensor,  # (tiles, 2) column, row
    size: tuple[int, int],  # width, height
) -> Tensor:
    """(V,) bool: whether alpha reaches ALPHA_MIN in the hull of a tile's pixel centres."""
    first = tiles[:, None].to(mean2d) * TILE + 0.5  # (tiles, 1, 2)
    last = torch.minimum(first + (TILE - 1), mean2d.new_tensor(size) - 0.5)
    low, high = first - mean2d, last - mean2d  # (tiles, V, 2)
    # The quadratic form is convex: its minimum over the rectangle lies on an edge that faces the
    # centre, at the unconstrained minimum along that edge, clamped to the edge.
    near = torch.zeros_like(low).clamp(low, high)
    xx, xy, yy = covariance.unbind(-1)
    on_x = torch.stack([near[..., 0], (near[..., 0] * xy / xx)], -1).clamp(low, high)
    on_y = torch.stack([(near[..., 1] * xy / yy), near[..., 1]], -1).clamp(low, high)
    least = torch.minimum(exponent(covariance, on_x), exponent(covariance, on_y))
    return (least < torch.log(opacity / ALPHA_MIN)).any(dim=0)


def active_tile_positions(inputs: RenderInputs) -> Tensor:
    """(tiles, 2) column and row of each active tile."""
    left, top, right, bottom = inputs.tiles
    wanted = torch.ones(bottom - top, right - left, dtype=torch.bool)
    if inputs.tile_mask is not None:
        wanted = inputs.tile_mask.cpu()
    return wanted.nonzero().flip(1) + torch.tensor([left, top])


def active_pixels(inputs: RenderInputs) -> tuple[Tensor, Tensor]:
    """Return rows and columns of the pixels in active tiles, (P,) each, row by row."""
    wanted = torch.zeros(inputs.height, inputs.width, dtype=torch.bool)
    for column, row in (TILE * active_tile_positions(inputs)).tolist():
        wanted[row : row + TILE, column : column + TILE] = True
    rows, columns = wanted.nonzero().to(inputs.means.device).unbind(1)
    return rows, columns


def blend(
    inputs: RenderInputs, splats: ProjectedGaussians, camera: int
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Blend front to back (3DGS eq. 3).

    Returns image (H, W, 3), alpha (H, W), depth (H, W), each splat's largest weight and sum
    of weights, (V,) each, and the planes (5, H, W) of `Surface.of`.
    """
    image = inputs.background.expand(inputs.height, inputs.width, 3).clone()
    alpha, depth = image.new_zeros(image.shape[:2]), image.new_zeros(image.shape[:2])
    surface = image.new_zeros(5, *image.shape[:2])
    largest, weight_sum = (image.new_zeros(len(splats.index)) for _ in range(2))
    chunks = (torch.split(axis, PIXELS_AT_ONCE) for axis in active_pixels(inputs))
    for place in zip(*chunks, strict=True):
        pixels = torch.stack(place[::-1], -1).to(image) + 0.5
        weights, left = blending_weights(splats, pixels)
        image[place] = weights @ splats.colour + left[:, None] * inputs.background
        alpha[place] = total = 1 - left
        if inputs.with_surface:
            surface[:, *place] = blended_planes(splats, weights, pixels)
        with torch.no_grad():
            if inputs.with_depth == "median":
                depth[place] = median_depth(weights, total, splats.depth)
            else:
                depth[place] = weights @ splats.depth / torch.where(total > 0, total, 1.0)
            counts = torch.ones_like(left)
            if inputs.pixel_weights is not None:
                counts = inputs.pixel_weights[camera][place]
            weight_sum += counts @ weights
            if len(place[0]):
                largest = torch.maximum(largest, weights.amax(dim=0))
    return image, alpha, depth, largest, weight_sum, surface


def blended_planes(splats: ProjectedGaussians, weights: Tensor, pixels: Tensor) -> Tensor:
    """(5, P) of `Surface.of`, for weights (P, V) and pixel centres (P, 2)."""
    depth = splats.depth + ((pixels[:, None] - splats.mean2d) * splats.slope).sum(-1)  # (P, V)
    weights_so_far = weights.detach().cumsum(dim=1)
    after = (weights_so_far < 0.5).sum(dim=1, keepdim=True)  # splats in front of the median
    padded = torch.cat([depth, depth.new_zeros(len(depth), 1)], dim=1)
    median = padded.gather(1, after)[:, 0]
    return torch.cat([torch.stack([(weights * depth).sum(1), median]), (weights @ splats.normal).T])


def blending_weights(splats: ProjectedGaussians, pixels: Tensor) -> tuple[Tensor, Tensor]:
    """Return weights (P, V) for pixel centres (P, 2), and the remaining transmittance (P,).

    A weight is alpha_i prod_{j<i} (1 - alpha_j).
    """
    power = exponent(splats.covariance, pixels[:, None] - splats.mean2d)
    a = splats.opacity * torch.exp(-power)
    a = torch.where(a >= ALPHA_MIN, a.clamp(max=ALPHA_MAX), 0.0)
    behind = torch.cumprod(1 - a, dim=1)
    before = torch.cat([behind.new_ones(len(behind), 1), behind], dim=1)
    return a * before[:, :-1], before[:, -1]


def median_depth(weights: Tensor, total: Tensor, depth: Tensor) -> Tensor:
    """(P,) depth of the splat at which a pixel's weights (P, V) reach half of `total` (P,)."""
    reached = torch.searchsorted(weights.cumsum(dim=1), total[:, None] / 2)[:, 0]
    at = torch.cat([depth, depth.new_zeros(1)])[reached]  # no splat reaches half where V is 0
    return torch.where(total > 0, at, 0.0)


def record_grad2d(splats: ProjectedGaussians, grad2d: Tensor, width: int, height: int) -> None:
    """Make `backward` write the scaled norm of dL / d(mean2d) into `grad2d` (N,)."""
    if not splats.mean2d.requires_grad:
        return

    def write(gradient: Tensor) -> None:
        half_size = gradient.new_tensor([0.5 * width, 0.5 * height])
        grad2d[splats.index] = (gradient * half_size).norm(dim=-1).float()

    splats.mean2d.register_hook(write)  # type: ignore[no-untyped-call]
