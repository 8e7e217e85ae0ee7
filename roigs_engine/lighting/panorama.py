"""The light at a point of a scene: an equirectangular picture in linear light.

The picture is laid out as Blender's environment textures (docs/conventions.md): its middle looks
along the world's +x, its left quarter along +y, its top along +z.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage

from ..context import QUIET, Context
from ..errors import ConfigError
from ..model.roi import OrientedBox
from ..model.scene import Float64
from ..rasterize.instances import Instance
from ..rasterize.light import to_linear
from ..rasterize.panorama import render_panorama

CLIPPED = 250 / 255  # sRGB value of all channels from which photos may have lost light
THERE = 0.5  # alpha above which a pixel shows a surface
LAMP = 1.0  # least width of clipped light that counts, degrees
RAMP = 12  # degrees from the rim of a hole to its wholly unseen part

Float32 = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Panorama:
    """The light from all around, linear: 1 is white in the photos.

    Attributes:
        shown: (H, 2 H, 3) light that Gaussians show.
        guessed: (H, 2 H, 3) light that fills the holes; the sum of both has no holes.
        unseen: (H, 2 H) how deep a pixel is in a hole above the horizon, where lamps and the sky
            are: from 0, at the hole's rim and at the horizon, to 1.
        clipped: (H, 2 H) pixels whose light is too bright for the photos.
        seen: share of the directions, by solid angle, that Gaussians show.
        distance: (H, 2 H) distance of what is shown; `NOTHING` in empty pixels.
    """

    shown: Float32
    guessed: Float32
    unseen: Float32
    clipped: Mask
    seen: float
    distance: Float32

    @property
    def light(self) -> Float32:
        """Return the light (H, 2 H, 3) as the photos show it, with holes filled."""
        return self.shown + self.guessed

    def brightened(self, highlights: float, unseen: float | None = None) -> Float32:
        """Return the light (H, 2 H, 3) with two parts of it multiplied.

        The added light of unseen directions is neutral: cameras make the usual light white, and
        objects around a hole, such as a red cloth, are no lamps.

        Args:
            highlights: factor of clipped light.
            unseen: factor of unseen light above the horizon; None: it stays as guessed, for the
                picture that mirrors show.
        """
        bright = np.where(self.clipped[..., None], np.float32(highlights), np.float32(1))
        guessed = self.guessed
        if unseen is not None:
            neutral = unseen * guessed.mean(axis=-1, keepdims=True)
            guessed = guessed + self.unseen[..., None] * (neutral - guessed)
        return np.asarray(bright * self.shown + guessed, np.float32)

    def parts(self, rows: int) -> Float64:
        """Return the brightness (3, h, 2 h) of three parts: usual, clipped, and unseen light.

        Args:
            rows: about the number of rows h, if the panorama has more.
        """
        shown, guessed = (light.mean(axis=-1).astype(float) for light in (self.shown, self.guessed))
        unseen = self.unseen * guessed
        usual = np.where(self.clipped, 0, shown) + guessed - unseen
        parts = np.stack([usual, np.where(self.clipped, shown, 0), unseen])
        step = max(1, len(shown) // rows)
        height = len(shown) // step
        parts = parts[:, : height * step, : 2 * height * step]
        return np.asarray(parts.reshape(3, height, step, 2 * height, step).mean(axis=(2, 4)))


def directions(height: int) -> Float64:
    """Return the directions (H, 2 H, 3) of a panorama's pixels: unit vectors in the world."""
    around = np.pi - (np.arange(2 * height) + 0.5) / height * np.pi
    up = np.pi / 2 - (np.arange(height)[:, None] + 0.5) / height * np.pi
    parts = np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def solid_angles(height: int) -> Float64:
    """Return the solid angles (H, 1) of a panorama's pixels, steradians."""
    edges = np.sin(np.pi / 2 - np.arange(height + 1) / height * np.pi)
    return np.asarray((edges[:-1] - edges[1:])[:, None] * np.pi / height)


def panorama(
    models: Sequence[Instance], place: Float64, height: int, context: Context = QUIET
) -> Panorama:
    """Draw the light that comes to a place.

    Args:
        models: on the CPU; z is up in their world.
        place: (3,) in that world.
        height: of the picture, pixels; it is twice as wide.

    Raises:
        ConfigError: nothing is seen from there.
    """
    pose = np.eye(4)
    pose[:3, 3] = -place
    rays = torch.from_numpy(directions(height).astype(np.float32))
    device = torch.device(context.device)
    context.check_cancelled()
    layer = render_panorama(models, rays, height / math.pi, pose, device)
    image, alpha = layer.image, layer.alpha.numpy()
    if not alpha.max() > THERE:
        raise ConfigError(
            "Nothing is visible from there: the panorama would be empty.",
            "Move the point, or leave out less around it.",
        )
    light = to_linear(image).numpy()
    whole, there = filled(light, alpha), alpha[..., None]
    shown = np.where(there > THERE, whole, there * light)
    return Panorama(
        shown=shown,
        guessed=whole - shown,
        unseen=_unseen(alpha),
        clipped=_lamps((image >= CLIPPED).all(dim=-1).numpy() & (alpha > THERE)),
        seen=float((alpha * solid_angles(height)).sum() / (4 * np.pi)),
        distance=layer.depth.numpy(),
    )


def _lamps(white: Mask) -> Mask:
    """Remove thin lines and dots from white areas; they are bright edges, and no lamps."""
    side = math.ceil(LAMP / 180 * len(white))
    return np.asarray(ndimage.binary_opening(white, np.ones((side, side))))


def _unseen(alpha: Float32) -> Float32:
    """Return `Panorama.unseen` (H, 2 H); it rises slowly, so that no edge is visible."""
    height, width = alpha.shape
    hole = np.concatenate([alpha, alpha, alpha], axis=1) <= THERE  # left and right edges meet
    hole = np.pad(hole, ((height, 0), (0, 0)), mode="reflect")  # nothing ends at the zenith
    inside = ndimage.distance_transform_edt(hole)[height:, width : 2 * width]
    ramp = RAMP / 180 * height
    above = (height / 2 - 0.5 - np.arange(height)[:, None]) / ramp
    return np.asarray(np.clip(inside / ramp, 0, 1) * np.clip(above, 0, 1), np.float32)


def filled(light: Float32, alpha: Float32) -> Float32:
    """Fill the holes of a picture with their surroundings, from farther away in wider holes.

    It uses pyramids (pull and push, Gortler et al. 1996). The left and right edges meet.

    Args:
        light: (H, W, 3); H and W are powers of 2, or odd at some level of the pyramid.
        alpha: (H, W) how much of a pixel is known, 0 to 1.
    """
    height, width = alpha.shape
    if min(height, width) < 2:
        mean = (light * alpha[..., None]).sum(axis=(0, 1)) / max(float(alpha.sum()), 1e-6)
        smaller = np.broadcast_to(mean, light.shape)
    else:
        parts = np.concatenate([light * alpha[..., None], alpha[..., None]], axis=-1)
        half = _halved(parts)
        share = half[..., 3]
        below = filled(half[..., :3] / np.maximum(share, 1e-6)[..., None], np.clip(share, 0, 1))
        smaller = _doubled(below, height, width)
    return np.asarray(alpha[..., None] * light + (1 - alpha[..., None]) * smaller, np.float32)


def _halved(picture: Float32) -> Float32:
    """Return the means of 2 x 2 pixels; a last odd row or column counts twice."""
    height, width = picture.shape[:2]
    padded = np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    rows, columns = padded.shape[0] // 2, padded.shape[1] // 2
    return np.asarray(padded.reshape(rows, 2, columns, 2, -1).mean(axis=(1, 3)), np.float32)


def _doubled(picture: Float32, height: int, width: int) -> Float32:
    """Double a picture, with bilinear interpolation, and crop it to a size."""
    across = np.concatenate([picture[:, -1:], picture, picture[:, :1]], axis=1)
    both = np.concatenate([across[:1], across, across[-1:]], axis=0)
    for axis in (0, 1):
        before, at, after = (
            np.take(both, range(start, both.shape[axis] - 2 + start), axis) for start in range(3)
        )
        pair = np.stack([0.75 * at + 0.25 * before, 0.75 * at + 0.25 * after], axis=axis + 1)
        shape = list(pair.shape)
        shape[axis : axis + 2] = [2 * shape[axis]]
        both = pair.reshape(shape)
    return np.asarray(both[:height, :width], np.float32)


def left_out(
    model: Instance, boxes: Sequence[OrientedBox], place: Float64, near: float
) -> Instance:
    """Return a model without Gaussians in boxes or near a place.

    Args:
        model: a model whose own world is that of the boxes.
        place: (3,) in the world.
        near: Gaussians with centres nearer to the place are left out, world units.
    """
    centres = model.gaussians.means.double().numpy()
    kept = np.ones(len(centres), bool)
    if boxes:
        own = centres / model.frame.scale + model.frame.origin
        for roi in boxes:
            kept &= ~roi.contains(own)
    if near > 0:
        matrix = model.from_frame
        away = centres @ matrix[:3, :3].T + matrix[:3, 3] - place
        kept &= np.linalg.norm(away, axis=1) >= near
    if kept.all():
        return model
    return replace(model, gaussians=model.gaussians.rows(torch.from_numpy(kept)))
