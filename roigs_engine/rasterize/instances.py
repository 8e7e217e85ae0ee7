"""Instances: models under affine transforms, rendered together as a layer for compositing.

Everything is computed in a frame with its origin at the camera, so places far from the world's
origin cost no precision. Its axes are those of the largest model, which therefore needs no
rotation. View dependence rotates with a model: colours of the other models are evaluated in their
own frames, and drawn as plain colours.

A picture with depth of field or motion blur is the mean of sharp ones, each from another point of
the lens and at another time (Cook et al. 1984, distributed ray tracing).
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from ..cuda.device import CPU
from ..formats.targets import target_with
from ..kernels import bindings
from ..model.gaussians import SH_C0, Gaussians
from ..model.local_frame import LocalFrame
from ..model.operations import faded, recoloured
from ..model.rotations import rotation_matrices
from ..model.scene import Camera, Float64
from .inputs import Blur, blur_of
from .light import to_linear, to_srgb
from .limits import PICTURE_LIMITS
from .mattes import object_shares
from .reference import drawn_share, jacobian, sh_basis
from .view import pixel_size, rasterize_view

NOTHING = 1e10  # depth of empty pixels, as in Blender's depth pass
NEAREST = 1e-5  # triangles nearer than this share of the farthest depth hide nothing
SIMILAR = 1e-5  # largest relative difference of the scales of a similarity


@dataclass(frozen=True, kw_only=True, eq=False)
class Instance:
    """A model and its pose."""

    gaussians: Gaussians  # in `frame`, on the CPU
    frame: LocalFrame  # of the model's own world
    matrix: Float64  # (4, 4) from the model's own world to the world; any affine one
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)  # red, green, blue, see `recoloured`
    density: float = 1.0  # see `faded`
    object_index: int = 0  # object to which its shares of a picture count, see `Layer`

    @property
    def from_frame(self) -> Float64:
        """(4, 4) from the Gaussians' frame to the world."""
        to_world = np.diag([*[1 / self.frame.scale] * 3, 1.0])
        to_world[:3, 3] = self.frame.origin
        return np.asarray(self.matrix @ to_world)


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """A picture for compositing.

    The depth is the median. A mean would lie between a slightly transparent object and the surface
    behind it, and a mesh between the two would be drawn in front.
    """

    image: Tensor  # (H, W, 3) sRGB values from 0 to 1, not multiplied by alpha
    alpha: Tensor  # (H, W) from 0 to 1
    depth: Tensor  # (H, W) along the camera's axis, world units; NOTHING where empty
    shares: Mapping[int, Tensor] = field(default_factory=dict)
    """(H, W) shares of alpha by object index; empty if not requested."""


@torch.no_grad()
def render_instances(
    models: Sequence[Instance],
    camera: Camera,
    world_to_camera: Float64,
    device: torch.device = CPU,
    *,
    mattes: bool = False,
) -> Layer:
    """Render models together, on a device; they need at least one Gaussian in all.

    With `mattes`, the layer has the share of each object index.
    """
    mixed = len({(m.gaussians.target, m.gaussians.photo_focal) for m in models}) > 1
    axes = world_to_camera[:3, :3] if mixed else _axes(models, world_to_camera)
    to_frame, pose = np.eye(4), np.eye(4)
    to_frame[:3, :3], pose[:3, :3] = axes, world_to_camera[:3, :3] @ axes.T
    to_frame[:3, 3] = pose[:3, :3].T @ world_to_camera[:3, 3]
    parts = [_seen(model, to_frame) for model in models]
    scale = LocalFrame.of_centres(np.concatenate([part.means.numpy() for part in parts])).scale
    if mixed:
        parts = _alike(parts, camera)
    drawn = parts[0] if len(parts) == 1 else Gaussians.concatenate(parts)
    drawn = replace(
        drawn,
        means=(drawn.means * scale).float(),
        log_scales=drawn.log_scales + float(np.log(scale)),
    ).to(device)
    output = rasterize_view(drawn, camera, pose, limits=PICTURE_LIMITS, with_depth="median")
    assert output.depth is not None
    alpha, depth = output.alpha[0].cpu(), output.depth[0].cpu()
    shares, image = alpha.clamp(min=1e-6)[..., None], output.image[0].cpu()
    linear = drawn.target.linear_light
    image = to_srgb(to_linear(image) / shares) if linear else image / shares
    alpha, of_objects = alpha.clamp(0, 1), {}
    if mattes:
        indices = torch.tensor([model.object_index for model in models])
        rows = indices.repeat_interleave(torch.tensor([len(part) for part in parts]))
        of_objects = object_shares(drawn, rows, alpha, camera, pose)
    return Layer(
        image=image.clamp(0, 1),
        alpha=alpha,
        depth=torch.where(alpha > 0, depth / scale, NOTHING),
        shares=of_objects,
    )


def surface_depth(triangles: Tensor, camera: Camera, world_to_camera: Float64) -> Tensor:
    """Return the depth of opaque triangles at each pixel's centre; `NOTHING` elsewhere.

    Triangles are visible from both sides.

    Args:
        triangles: (T, 3, 3) float32 corners in the world.
        camera, world_to_camera: of the picture.

    Returns:
        (H, W) float32, along the camera's axis, world units.
    """
    pose = torch.from_numpy(world_to_camera)
    seen = (triangles.double() @ pose[:3, :3].T + pose[:3, 3]).float().contiguous()
    depth = torch.full((camera.height, camera.width), NOTHING)
    if len(seen) and (farthest := float(seen[..., 2].max())) > 0:
        lens = (ctypes.c_double * 4)(camera.fx, camera.fy, camera.cx, camera.cy)
        bindings.kernels().roigs_surface_depth(
            bindings.pointer(seen),
            len(seen),
            lens,
            NEAREST * farthest,
            camera.width,
            camera.height,
            bindings.pointer(depth),
        )
    return depth


def mean_layer(samples: Iterable[tuple[Layer, Tensor]], *, below: bool = False) -> Layer:
    """Return the mean, in linear light, of one or more layers with the depths (H, W) of surfaces.

    Gaussians behind surfaces are left out of each layer, because a blurred pixel has no single
    depth. The mean's depth is that of the remaining Gaussians, with a negative sign: no surface is
    in front of them.

    Args:
        samples: the layers and depths.
        below: whether the surfaces' own picture is transparent where there are no surfaces. Where
            surfaces are more often in front of the Gaussians than behind, their picture then lies
            over the Gaussians, whose depth is 10 times `NOTHING`. At blurred edges in front, the
            two cover different shares of a pixel, and alpha is that of the Gaussians in their own
            share.
    """
    light, alpha, depth = torch.zeros(()), torch.zeros(()), torch.zeros(())
    front, behind, count = torch.zeros(()), torch.zeros(()), 0
    shares: dict[int, Tensor] = {}
    for layer, surfaces in samples:
        hidden = surfaces <= layer.depth
        seen = layer.alpha * ~hidden
        light = light + to_linear(layer.image) * seen[..., None]
        depth = depth + seen * torch.where(seen > 0, layer.depth, 0)
        there = surfaces < NOTHING
        front, behind = front + (hidden & there).float(), behind + (~hidden & there).float()
        alpha, count = alpha + seen, count + 1
        for index, share in layer.shares.items():
            shares[index] = shares.get(index, 0) + share * ~hidden
    image = to_srgb(light / alpha.clamp(min=1e-6)[..., None])
    depth = -torch.where(alpha > 0, depth / alpha.clamp(min=1e-6), NOTHING)
    under = (front > behind) if below else torch.zeros_like(alpha, dtype=torch.bool)
    divisor = torch.where(under, (count - front).clamp(min=1), count)
    return Layer(
        image=image.clamp(0, 1),
        alpha=alpha / divisor,
        depth=torch.where(under, 10 * NOTHING, depth),
        shares={index: share / divisor for index, share in shares.items()},
    )


def _axes(models: Sequence[Instance], world_to_camera: Float64) -> Float64:
    """(3, 3) rotation from the world to the axes of the largest model.

    If that model is mirrored, stretched or sheared, they are the axes of the camera.
    """
    linear = max(models, key=lambda model: len(model.gaussians)).matrix[:3, :3]
    u, scales, v = np.linalg.svd(linear)
    rotation = u @ v
    if np.linalg.det(rotation) > 0 and scales[0] <= (1 + SIMILAR) * scales[2]:
        return np.asarray(rotation.T)
    return world_to_camera[:3, :3]


def _seen(model: Instance, to_frame: Float64) -> Gaussians:
    """Return the model around the camera, with float64 centres; if rotated, with plain colours.

    `to_frame` is the rigid (4, 4) from the world to a frame with its origin at the camera.
    """
    matrix = to_frame @ model.from_frame
    if _scale(matrix[:3, :3]) is not None:
        return posed(model, matrix, model.gaussians.sh)
    eye: Float64 = -np.linalg.solve(matrix[:3, :3], matrix[:3, 3]).astype(np.float64)
    return posed(model, matrix, _plain(model.gaussians, eye))


def _scale(linear: Float64) -> float | None:
    """Return the factor of a linear map (3, 3) that only scales; None for another map."""
    scale = float(np.trace(linear)) / 3
    alike = scale > 0 and np.abs(linear - scale * np.eye(3)).max() <= SIMILAR * scale
    return scale if alike else None


def posed(model: Instance, matrix: Float64, sh: Tensor) -> Gaussians:
    """Return the model after an affine map, with float64 centres.

    Args:
        model: its gains and density are applied.
        matrix: (4, 4) from the Gaussians' frame.
        sh: (N, K, 3) colours after the map, without the gains.
    """
    gaussians, linear = model.gaussians, matrix[:3, :3]
    quats, log_scales = transformed(gaussians, linear)
    centres = gaussians.means.numpy().astype(np.float64) @ linear.T + matrix[:3, 3]
    return replace(
        gaussians,
        means=torch.from_numpy(centres),
        quats=quats,
        log_scales=log_scales,
        logit_opacities=faded(gaussians.logit_opacities, model.density),
        sh=recoloured(sh, model.gains),
    )


def _alike(parts: Sequence[Gaussians], camera: Camera) -> list[Gaussians]:
    """Return models in the camera's frame, without anti-aliasing, in the light of most Gaussians.

    All get the widest blur of the models.
    """
    linear = sum(len(part) if part.target.linear_light else -len(part) for part in parts) > 0
    blurs = [
        blur_of(pixel_size(part, camera), part.antialiased, part.target.blur) for part in parts
    ]
    widest = max(blur.drawn for blur in blurs)
    target = replace(target_with(antialiased=False, linear_light=linear), blur=widest)
    made = [
        part if blur.stored == widest else _for_camera(part, camera, blur._replace(drawn=widest))
        for part, blur in zip(parts, blurs, strict=True)
    ]
    return [replace(part, target=target, photo_focal=None) for part in made]


def _for_camera(seen: Gaussians, camera: Camera, blur: Blur) -> Gaussians:
    """Return a model in the camera's frame whose opacities replace a blur, seen from this camera.

    So it can be drawn together with others: a blur wider than the stored one only lowers
    opacities, by a factor that depends on the Gaussian's picture in one camera (`blur_of`).
    """
    matrix = torch.as_tensor(camera.matrix(), dtype=torch.float32)
    # Gaussians before the near plane are not drawn, so their values do not matter.
    U = jacobian(seen.means.float(), matrix, camera.width, camera.height) @ principal_axes(seen)
    share = drawn_share(U, blur)
    logits = torch.logit((seen.logit_opacities.sigmoid() * share).nan_to_num(0.0), eps=1e-7)
    return replace(seen, logit_opacities=logits)


def _plain(gaussians: Gaussians, eye: Float64) -> Tensor:
    """(N, 1, 3) SH of degree 0 with the colours seen from `eye`."""
    direction = gaussians.means - torch.from_numpy(eye).to(gaussians.means)
    basis = sh_basis(torch.nn.functional.normalize(direction, dim=-1))
    colour = torch.einsum("vk,vkc->vc", basis[:, : gaussians.sh.shape[1]], gaussians.sh)
    return ((colour.clamp(min=-0.5)) / SH_C0)[:, None]


def principal_axes(gaussians: Gaussians) -> Tensor:
    """(N, 3, 3) axes of each ellipsoid in the columns, one standard deviation long."""
    rotations = rotation_matrices(torch.nn.functional.normalize(gaussians.quats, dim=1))
    return rotations * gaussians.log_scales.exp()[:, None, :]


def transformed(gaussians: Gaussians, linear: Float64) -> tuple[Tensor, Tensor]:
    """Return rotations (N, 4) and logarithms of scales (N, 3) after a linear map (3, 3)."""
    if (scale := _scale(linear)) is not None:
        return gaussians.quats, gaussians.log_scales + float(np.log(scale))
    scales = np.linalg.svd(linear, compute_uv=False)
    if scales[0] <= (1 + SIMILAR) * scales[2]:
        # A reflection has the same ellipsoids as the rotation that reverses all axes with it.
        rotation = linear / np.cbrt(np.linalg.det(linear))
        old = Rotation.from_quat(np.roll(gaussians.quats.numpy(), -1, axis=1))  # scipy has xyzw
        quats = _quats(Rotation.from_matrix(rotation) * old)
        return quats, gaussians.log_scales + float(np.log(scales.mean()))
    axes = principal_axes(gaussians)
    u, stretched, _ = torch.linalg.svd(torch.from_numpy(linear).to(axes) @ axes)
    u = u * torch.linalg.det(u)[:, None, None]  # a rotation; the sign of an axis does not matter
    quats = _quats(Rotation.from_matrix(u.numpy()))
    return quats, stretched.clamp(min=torch.finfo(torch.float32).tiny).log()


def _quats(rotations: Rotation) -> Tensor:
    """(N, 4) quaternions wxyz."""
    return torch.from_numpy(np.roll(rotations.as_quat(), 1, axis=1).astype(np.float32))
