"""gsplat's interface on the CPU: the calls of version 1.5.3 that the engine uses, in plain torch.

Written from gsplat's documentation, to test what is passed to it and what is made of its answers
where there is no card. As its kernels do, it leaves rows and pixels that it skips unwritten: NaN
here. Loops over Gaussians and tiles: for a hundred Gaussians, not for more.
"""

from __future__ import annotations

import torch
from torch import Tensor

from roigs_engine.model.rotations import rotation_matrices
from roigs_engine.rasterize.reference import sh_basis

ALPHA_MIN, ALPHA_MAX, LAST_LIGHT = 1 / 255, 0.999, 1e-4
__version__ = "1.5.3"


def _scattered(rows: Tensor, values: Tensor, count: int) -> Tensor:
    """(count, ...) with `values` at `rows`, NaN elsewhere."""
    whole = torch.full((count, *values.shape[1:]), float("nan"))
    return whole.index_copy(0, rows, values)


def fully_fused_projection(
    means: Tensor,
    covars: Tensor | None,
    quats: Tensor | None,
    scales: Tensor | None,
    viewmats: Tensor,
    Ks: Tensor,  # noqa: N803
    width: int,
    height: int,
    eps2d: float = 0.3,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    packed: bool = False,
    sparse_grad: bool = False,
    calc_compensations: bool = False,
    camera_model: str = "pinhole",
    opacities: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor, Tensor, None]:
    assert covars is None and not packed and camera_model == "pinhole" and len(viewmats) == 1
    view, K = viewmats[0], Ks[0]  # noqa: N806
    with torch.no_grad():
        z = (means @ view[:3, :3].T + view[:3, 3])[:, 2]
        rows = ((z >= near_plane) & (z <= far_plane)).nonzero()[:, 0]
    t = means[rows] @ view[:3, :3].T + view[:3, 3]
    x, y, z = t.unbind(-1)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    edge_x, edge_y = 0.15 * width / fx, 0.15 * height / fy
    near_x = z * (x / z).clamp(-cx / fx - edge_x, (width - cx) / fx + edge_x)
    near_y = z * (y / z).clamp(-cy / fy - edge_y, (height - cy) / fy + edge_y)
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [fx / z, zero, -fx * near_x / z**2, zero, fy / z, -fy * near_y / z**2], -1
    ).reshape(-1, 2, 3)
    half = (
        jacobian
        @ view[:3, :3]
        @ (rotation_matrices(torch.nn.functional.normalize(quats[rows])) * scales[rows][:, None])
    )
    covariance = half @ half.mT + eps2d * torch.eye(2)
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    conics = torch.stack([yy, -xy, xx], -1) / (xx * yy - xy * xy)[:, None]
    means2d = torch.stack([fx * x / z + cx, fy * y / z + cy], -1)
    with torch.no_grad():
        reach = (2 * (opacities[rows] / ALPHA_MIN).log()).sqrt().nan_to_num(3.33).clamp(max=3.33)
        sides = (reach[:, None] * covariance.diagonal(dim1=1, dim2=2).sqrt()).ceil()
        size = torch.tensor([width, height])
        off = ((means2d + sides <= 0) | (means2d - sides >= size)).any(-1)
        off |= (opacities[rows] < ALPHA_MIN) | (sides <= radius_clip).all(-1)
        radii = torch.zeros(len(means), 2, dtype=torch.int32)
        radii[rows] = torch.where(off[:, None], 0, sides.nan_to_num(0, 1e6)).int()
        kept = (~off).nonzero()[:, 0]
    count, rows = len(means), rows[kept]
    projected = (_scattered(rows, v[kept], count)[None] for v in (means2d, z, conics))
    return radii[None], *projected, None


def spherical_harmonics(
    degrees_to_use: int, dirs: Tensor, coeffs: Tensor, masks: Tensor | None = None
) -> Tensor:
    assert masks is not None and masks.shape == dirs.shape[:-1]
    rows, used = masks.nonzero()[:, 0], (degrees_to_use + 1) ** 2
    basis = sh_basis(torch.nn.functional.normalize(dirs[rows], dim=-1))[:, :used]
    return _scattered(rows, torch.einsum("vk,vkc->vc", basis, coeffs[rows][:, :used]), len(dirs))


def isect_tiles(
    means2d: Tensor,
    radii: Tensor,
    depths: Tensor,
    tile_size: int,
    tile_width: int,
    tile_height: int,
    sort: bool = True,
    segmented: bool = False,
    packed: bool = False,
    n_images: int | None = None,
    image_ids: Tensor | None = None,
    gaussian_ids: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    assert radii.dtype == torch.int32 and means2d.shape == radii.shape and len(means2d) == 1
    touched, pairs = torch.zeros_like(depths, dtype=torch.int32), []
    for g in (radii[0] > 0).all(-1).nonzero()[:, 0].tolist():
        low = (means2d[0, g] - radii[0, g]) / tile_size
        high = (means2d[0, g] + radii[0, g]) / tile_size
        left, top = (max(0, int(v)) for v in low.floor().tolist())
        right = min(tile_width, int(high[0].ceil()))
        bottom = min(tile_height, int(high[1].ceil()))
        bits = int(depths[0, g].detach().view(torch.int32))
        for row in range(top, bottom):
            pairs += [((row * tile_width + c) << 32 | bits, g) for c in range(left, right)]
        touched[0, g] = max(0, right - left) * max(0, bottom - top)
    pairs.sort()
    keys = torch.tensor([key for key, _ in pairs], dtype=torch.int64)
    return touched, keys, torch.tensor([g for _, g in pairs], dtype=torch.int32)


def isect_offset_encode(
    isect_ids: Tensor, n_images: int, tile_width: int, tile_height: int
) -> Tensor:
    tiles = torch.arange(tile_width * tile_height)
    starts = torch.searchsorted((isect_ids >> 32).contiguous(), tiles)
    return starts.int().reshape(n_images, tile_height, tile_width)


def rasterize_to_pixels(
    means2d: Tensor,
    conics: Tensor,
    colors: Tensor,
    opacities: Tensor,
    image_width: int,
    image_height: int,
    tile_size: int,
    isect_offsets: Tensor,
    flatten_ids: Tensor,
    backgrounds: Tensor | None = None,
    masks: Tensor | None = None,
    packed: bool = False,
    absgrad: bool = False,
) -> tuple[Tensor, Tensor]:
    assert backgrounds is not None and backgrounds.shape == (1, colors.shape[-1])
    assert masks is None or masks.shape == isect_offsets.shape
    _, rows, columns = isect_offsets.shape
    assert rows * tile_size >= image_height and columns * tile_size >= image_width
    ends = torch.cat([isect_offsets.flatten()[1:], torch.tensor([len(flatten_ids)])])
    image = backgrounds[0].expand(image_height, image_width, -1).clone()
    alpha = torch.full((image_height, image_width), float("nan"))
    for tile, (begin, end) in enumerate(zip(isect_offsets.flatten().tolist(), ends, strict=True)):
        row, column = divmod(tile, columns)
        if masks is not None and not masks[0, row, column]:
            continue
        ys = torch.arange(row * tile_size, min((row + 1) * tile_size, image_height))
        xs = torch.arange(column * tile_size, min((column + 1) * tile_size, image_width))
        place = (ys[:, None].expand(-1, len(xs)), xs[None].expand(len(ys), -1))
        g = flatten_ids[begin:end].long()
        pixels = torch.stack(place[::-1], -1)[:, :, None] + 0.5
        dx, dy = (means2d[0, g] - pixels).unbind(-1)
        xx, xy, yy = conics[0, g].unbind(-1)
        power = 0.5 * (xx * dx * dx + yy * dy * dy) + xy * dx * dy
        a = (opacities[0, g] * torch.exp(-power)).clamp(max=ALPHA_MAX)
        a = torch.where((power >= 0) & (a >= ALPHA_MIN), a, 0)
        a = torch.where(torch.cumprod(1 - a, -1) > LAST_LIGHT, a, 0)
        after = torch.cumprod(1 - a, -1)
        before = torch.cat([torch.ones(*after.shape[:2], 1), after], -1)
        light = before[..., -1]
        colour = (a * before[..., :-1]) @ colors[0, g] + light[..., None] * backgrounds[0]
        image = image.index_put(place, colour)
        alpha = alpha.index_put(place, 1 - light)
    return image[None], alpha[None, ..., None]
