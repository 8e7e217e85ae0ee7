"""Importance pruning: removes Gaussians with little effect when densification ends (ours).

It removes as many of the least important Gaussians as hardly change the photos (docs/method.md,
"Faint Gaussians"). Photos are judged one by one, and a smaller error counts as unchanged. Otherwise
a photo covered by fog would decide: without the fog, its error falls to a fraction, and most
Gaussians could be removed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from ...context import QUIET, Context
from ...model.roi import OrientedBox
from ...model.scene import PosedImage
from ..config import Mechanism, TrainConfig, limited
from ..photo_order import evenly_spaced
from ..running import Running
from .density_control import DensityControl
from .masked_steps import MaskedSteps

if TYPE_CHECKING:
    from torch import Tensor

    from ...model.gaussians import Gaussians
    from ..running import Training
    from ..stage_data import PhotoViews
    from ..state_reader import StateReader

WHOLE, EACH = 16, 8  # photos that are used: of all, and of those that see each box
MOST = 0.9  # largest share of the Gaussians that may be removed
HALVINGS = 5  # bisections of this range, down to 3 % of the Gaussians

Errors = Iterable[tuple[int, float]]
"""Squared errors of a model in single photos, each with its part: 0 is the whole photo, the others
are the boxes. They are found as they are asked for."""


@dataclass(frozen=True, kw_only=True)
class ImportancePruning(Mechanism):
    """Removes as many of the least important Gaussians as the photos do not miss.

    Earns: 29 % fewer Gaussians at 0.00 dB. Draft, six boxes of kumamon, flowerpot and the demo,
        two seeds (notebook/leave_one_out.md).

    Attributes:
        growth: largest share by which the photos' squared error may grow.
    """

    name: ClassVar[str] = "importance_pruning"
    needs = (DensityControl,)  # other stages do not add superfluous Gaussians

    growth: float = limited(0.05, above=0)

    def acts(self, config: TrainConfig) -> bool:
        return config.of(DensityControl).ends_within(config)

    def begin(self, config: TrainConfig, training: Training) -> Running:
        by_box = config.get(MaskedSteps) is not None
        return _Running(self.growth, config.of(DensityControl).until, by_box=by_box)

    def check_state(self, state: StateReader) -> None:
        state.flag("done")
        state.tensors({}, besides=("done",))


class _Running(Running):
    kept = ("done",)

    def __init__(self, growth: float, due: int, *, by_box: bool) -> None:
        self._growth, self._due, self._by_box = growth, due, by_box
        self.done = False

    def between_steps(self, training: Training, context: Context) -> bool:
        if self.done or training.step < self._due or not training.settled():
            return True

        def search() -> Tensor:
            data, model = training.data, training.gaussians
            rois = data.rois if self._by_box else ()
            errors = PhotoErrors(training.photos, rois, data.backgrounds, context)
            worth = visible_worth(model, data.images, context)
            return least_important(worth, lambda kept: errors(model.rows(kept)), self._growth)

        self.done = training.prune(
            context, "Gaussians with hardly any effect on the photos", search
        )
        return self.done


def visible_worth(
    gaussians: Gaussians, images: Sequence[PosedImage], context: Context = QUIET
) -> Tensor:
    """(N,) estimate of how much the photos' squared error depends on each Gaussian.

    It is the sum over photos of the Gaussian's largest blending weight times the sum of its
    weights. This is an upper bound of the sum of its squared weights. Photos have half their size.
    """
    import torch

    from ...rasterize.view import blending_weights

    worth = torch.zeros(len(gaussians), dtype=torch.float64, device=gaussians.means.device)
    sides = [max(image.camera.width, image.camera.height) // 2 for image in images]
    half = [
        (image.camera.thumbnail(side), image.world_to_camera)
        for image, side in zip(images, sides, strict=True)
    ]
    for weights in blending_weights(gaussians, half, context):
        worth += weights.total * weights.largest
    return worth


class PhotoErrors:
    """The mean squared errors of a model on some of its training photos.

    Args:
        views: the photos.
        rois: each box is judged separately, on photos that see it. The loss of a small box that few
            photos show would not matter in the whole.
        backgrounds: (photos, 3) colours behind everything; None for black.
        context: checked for cancellation.
    """

    def __init__(
        self,
        views: PhotoViews,
        rois: Sequence[OrientedBox],
        backgrounds: Tensor | None,
        context: Context = QUIET,
    ) -> None:
        self._views, self._rois = views, rois
        self._backgrounds, self._context = backgrounds, context
        self._whole = frozenset(evenly_spaced(range(len(views.images)), WHOLE))
        self._seeing = []
        for roi in rois:
            areas = [roi.projected_area(i.camera, i.world_to_camera) for i in views.images]
            seeing = [k for k, area in enumerate(areas) if area > 0]
            self._seeing.append(evenly_spaced(seeing, EACH))

    def __call__(self, gaussians: Gaussians) -> Iterator[tuple[int, float]]:
        """Yield for each photo the error on the whole, and on the silhouettes of its boxes.

        Only pixels that count are used; parts without any are left out.
        """
        import torch

        from ...cuda.device import sent

        for index in sorted(self._whole.union(*self._seeing)):
            self._context.check_cancelled()
            squares, counted = self._squares(gaussians, index)
            parts = [(0, counted)] if index in self._whole else []
            image = self._views.images[index]
            for box, (roi, seeing) in enumerate(zip(self._rois, self._seeing, strict=True), 1):
                if index in seeing:
                    silhouette = roi.silhouette(image.camera, image.world_to_camera)
                    shown = sent(torch.from_numpy(silhouette), counted.device)
                    parts.append((box, counted & shown))
            for part, pixels in parts:
                if pixels.any():
                    yield part, float(squares[pixels].mean(dtype=torch.float64))

    def _squares(self, gaussians: Gaussians, index: int) -> tuple[Tensor, Tensor]:
        """(H, W) squared errors, and (H, W) bool: which pixels count."""
        import torch

        from ...rasterize import rasterize
        from ..loss_masks import split_mask
        from ..losses import clipped_like

        photo, counted = split_mask(self._views.photo(index))
        options: dict[str, Any] = self._views.view(index)._asdict()
        if self._backgrounds is not None:
            options["background"] = self._backgrounds[index]
        output = rasterize(
            gaussians.means,
            gaussians.quats,
            gaussians.log_scales,
            gaussians.logit_opacities,
            gaussians.sh,
            raw=True,
            **gaussians.target.drawing,
            **options,
        )
        picture = clipped_like(output.image[0], self._views.images[index])
        squares = (picture - photo / 255.0).square().mean(dim=-1)
        return squares, torch.ones_like(squares, dtype=torch.bool) if counted is None else counted


def least_important(worth: Tensor, errors: Callable[[Tensor], Errors], growth: float) -> Tensor:
    """(N,) bool: the Gaussians of least worth, as many as may be removed.

    Args:
        worth: (N,) of each.
        errors: returns the errors of the model with some of its rows, (N,) bool. Without any
            errors, none are removed.
        growth: largest mean growth of the photos' errors, in any part.
    """
    import torch

    order = worth.argsort(stable=True)
    order = order[worth[order] > 0]  # photos cannot judge Gaussians that they do not show

    def least(share: float) -> Tensor:
        found = torch.zeros(len(worth), dtype=torch.bool, device=worth.device)
        found[order[: int(share * len(order))]] = True
        return found

    before = list(errors(~least(0.0)))
    if not before:
        return least(0.0)
    few, many = 0.0, MOST
    for _ in range(HALVINGS):
        share = (few + many) / 2
        holds = is_within(before, errors(~least(share)), growth)
        few, many = (share, many) if holds else (few, share)
    return least(few)


def is_within(before: Sequence[tuple[int, float]], after: Errors, growth: float) -> bool:
    """Whether errors have grown by at most a share, in the mean over the photos of each part.

    Errors that fell count as unchanged. It stops reading errors as soon as the answer is no.
    """
    photos = Counter(part for part, _ in before)
    grown = dict.fromkeys(photos, 0.0)
    for (part, was), (_, now) in zip(before, after, strict=True):
        grown[part] += max(now / max(was, 1e-12) - 1, 0.0)
        if not grown[part] <= growth * photos[part]:  # or it is NaN
            return False
    return True
