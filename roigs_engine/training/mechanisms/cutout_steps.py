"""Steps on the boxes' objects alone, drawn without the rest of the scene.

Fog in front of an object changes its pixels, and the object's colours learn to compensate: drawn
alone, they are wrong. Gaussians on its edge extend beyond it. In pixels outside its mask, the
object must be invisible, unless something is in front of it.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...context import QUIET, Context
from ...model.roi import OrientedBox
from ...model.scene import PosedImage
from ...photos.exposures import MOST, white
from ...photos.mask_images import load_mask, load_object_mask
from ..config import Mechanism, TrainConfig
from ..photo_order import mixed, shuffled
from ..running import Running

if TYPE_CHECKING:
    from torch import Tensor

    from ...model.gaussians import Gaussians
    from ..running import Training

EVERY = 4  # one step in so many is an ordinary one
MASKED_SHARE = 0.15  # share of the others that uses a photo with a mask of the object
BLOCKED = 0.5  # an object is hidden where this share of a pixel's light is from things before it
CORE = 2  # in a photo without a mask, pixels this near to the object's edge do not count
LEAST = 64  # a photo with fewer pixels of an object is not used for it


@dataclass(frozen=True, kw_only=True)
class CutoutSteps(Mechanism):
    """Most steps draw one object alone, on a random colour, and compare it with a photo.

    The stage must not add or remove Gaussians.

    Earns: objects alone, on all else, are +0.17, +0.39 and +0.82 dB nearer to their photos; whole
        photos lose 0.2 dB (demo, 640 px, vase, tin and clock, one seed; docs/measurements.md).
    """

    name: ClassVar[str] = "cutout_steps"
    uses_object_masks: ClassVar[bool] = True

    def begin(self, config: TrainConfig, training: Training) -> Running:
        from ..edits import morton_order

        data = training.data
        if data.labelled is None:
            return Running()
        model, owner = data.labelled()
        model = model.to(data.device)
        rows = morton_order(model.means)  # the trainer's
        model, owner = model.rows(rows), owner.to(data.device)[rows]
        return _Running(
            Cutouts(model, owner, data.rois, data.images, data.seed, training.context), config
        )


class _Running(Running):
    def __init__(self, cutouts: Cutouts, config: TrainConfig) -> None:
        self._cutouts, self._config = cutouts, config

    def own_step(self, training: Training) -> tuple[int, Tensor] | None:
        from ...cuda.device import number, sent
        from ..loss_masks import split_mask
        from ..losses import clipped_like, photo_loss

        cutout = self._cutouts.at(training.step)
        if cutout is None:
            return None
        target, _ = split_mask(training.photos.photo(cutout.photo))
        part = training.optimizer.part(cutout.rows)
        view = cutout.photo, cutout.box
        output = training.render(part, view, cutout.counted, background=cutout.background)
        window = cutout.window()
        image = training.data.images[cutout.photo]
        loss = photo_loss(
            clipped_like(output.image.squeeze(0), image)[window],
            cutout.target(target, white(image.exposure))[window],
            ssim_weight=self._config.ssim_weight,
            counted=sent(cutout.counted[window], target.device),
        )
        weight = number(cutout.loss_weight, target.device)
        (loss.loss * weight).backward()  # type: ignore[no-untyped-call]
        training.optimizer.put(part, cutout.rows)
        return cutout.photo, loss.loss.detach()


@dataclass(frozen=True, kw_only=True, eq=False)
class Cutout:
    """One object on one photo.

    Attributes:
        photo, box: their row numbers.
        rows: row numbers of the object's Gaussians, ascending.
        shown: (H, W) bool, the pixels that show the object.
        counted: (H, W) bool, the pixels to compare.
        background: (3,) the colour behind the object.
        loss_weight: of the mean loss over these pixels; a whole photo has 1.
    """

    photo: int
    box: int
    rows: Tensor
    shown: Tensor
    counted: Tensor
    background: Tensor
    loss_weight: float

    def window(self) -> tuple[slice, slice]:
        """Return rows and columns of the smallest rectangle around the pixels to compare."""
        ys, xs = (self.counted.any(dim=axis).nonzero()[:, 0] for axis in (1, 0))
        return slice(int(ys[0]), int(ys[-1]) + 1), slice(int(xs[0]), int(xs[-1]) + 1)

    def target(self, photo: Tensor, largest: int = MOST) -> Tensor:
        """Return the photo (H, W, 3) uint8 with the background's colour outside the object.

        `largest`: the photo's white, see `clipped_like`.
        """
        from ...cuda.device import sent

        behind = (self.background * MOST).round().clamp(max=largest).to(photo)
        return photo.where(sent(self.shown[..., None], photo.device), behind)


class Cutouts:
    """The objects that the steps of a stage draw alone; a function of (seed, step).

    Boxes without any object mask are left out.

    Args:
        model: at the start of the stage, in the order of its rows; the stage keeps all rows.
        owner: (N,) index of the box whose object each Gaussian belongs to, -1 for none.
        rois: the boxes.
        images: the photos.
        seed: of the order and the colours.
        context: checked for cancellation.
    """

    def __init__(
        self,
        model: Gaussians,
        owner: Tensor,
        rois: Sequence[OrientedBox],
        images: Sequence[PosedImage],
        seed: int,
        context: Context = QUIET,
    ) -> None:
        self._seed, self._device = seed, model.means.device
        self._rows = [(owner == index).nonzero()[:, 0] for index in range(len(rois))]
        self._pairs: list[tuple[int, int]] = []
        self._pixels: list[tuple[bytes, tuple[int, int]]] = []
        masked: list[int] = []
        shares: list[float] = []
        objects = {name for image in images for name in image.objects}
        boxes = [box for box, roi in enumerate(rois) if roi.name in objects]
        for photo, image in enumerate(images):
            for box in boxes:
                roi = rois[box]
                context.check_cancelled()
                found = self._compared(model, box, roi, image)
                if found is None or found[0].sum() < LEAST:
                    continue
                if roi.name in image.objects:
                    masked.append(len(self._pairs))
                self._pairs.append((photo, box))
                shares.append(float(found[1].mean()))
                packed = zlib.compress(np.packbits(np.stack(found)).tobytes(), 1)
                height, width = found[0].shape
                self._pixels.append((packed, (height, width)))
        self._weight = float(np.exp(np.mean(np.log(shares)))) if shares else 0.0
        others = [k for k in range(len(self._pairs)) if k not in set(masked)]
        first, second = others or masked, masked or others
        if self._pairs:
            order = shuffled(first, seed), shuffled(second, seed + 1)
            self._pair_at = mixed(*order, MASKED_SHARE)

    def at(self, step: int) -> Cutout | None:
        """Return the cutout of a step; None for an ordinary step."""
        import torch

        from ...cuda.device import sent

        if not self._pairs or step % EVERY == 0:
            return None
        pair = self._pair_at(step - step // EVERY - 1)
        photo, box = self._pairs[pair]
        packed, shape = self._pixels[pair]
        bits = np.unpackbits(np.frombuffer(zlib.decompress(packed), np.uint8))
        both = torch.from_numpy(bits[: 2 * shape[0] * shape[1]].reshape(2, *shape) > 0)
        colour = np.random.default_rng([self._seed, step]).random(3).astype(np.float32)
        return Cutout(
            photo=photo,
            box=box,
            rows=self._rows[box],
            shown=both[0],
            counted=both[1],
            background=sent(torch.from_numpy(colour), self._device),
            loss_weight=self._weight,
        )

    def _compared(
        self, model: Gaussians, box: int, roi: OrientedBox, image: PosedImage
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]] | None:
        """Return the pixels of a box's object, and those to compare; None for an unseen box."""
        from scipy.ndimage import binary_erosion

        from ...rasterize.view import rasterize_view

        rows, silhouette = self._rows[box], roi.silhouette(image.camera, image.world_to_camera)
        if not len(rows) or not silhouette.any():
            return None
        share = _share(model, rows, image)
        mask, counted = load_object_mask(image, roi.name), load_mask(image)
        if mask is None:
            shown = binary_erosion(share > 1 - BLOCKED, np.ones((2 * CORE + 1, 2 * CORE + 1)))
            used = shown
        else:
            view = rasterize_view(
                model.rows(rows), image.camera, image.world_to_camera, sh_degree=0
            )
            alone = np.asarray(view.alpha[0].cpu().numpy())
            shown = mask & silhouette
            used = silhouette & (mask | (alone - share < BLOCKED))
        if counted is not None:
            shown, used = shown & counted, used & counted
        return shown, used


def _share(model: Gaussians, rows: Tensor, image: PosedImage) -> NDArray[np.float32]:
    """(H, W) the share of each pixel's light that comes from these Gaussians."""
    import torch

    from ...model.gaussians import SH_C0
    from ...rasterize.view import rasterize_view

    sh = torch.full_like(model.sh[:, :1], -0.5 / SH_C0)
    sh[rows] = 0.5 / SH_C0
    labelled = model.with_tensors({"sh": sh})
    black = torch.zeros(3, device=sh.device)
    view = rasterize_view(
        labelled, image.camera, image.world_to_camera, sh_degree=0, background=black
    )
    return np.asarray(view.image[0, ..., 0].cpu().numpy())
