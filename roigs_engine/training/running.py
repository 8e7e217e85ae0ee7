"""Hooks of training mechanisms, and the trainer's interface for them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from ..context import Context

if TYPE_CHECKING:
    from torch import Tensor

    from ..model.gaussians import Gaussians
    from ..rasterize import RenderOutput
    from ..rasterize.inputs import Surface
    from ..rasterize.tiles import Mask
    from .edits import Edit
    from .loss_masks import LossMask
    from .optimizer import VisibleAdam
    from .stage_data import PhotoViews, StageData


class Training(Protocol):
    """The parts of the trainer that a mechanism may use."""

    context: Context
    step: int  # steps done
    data: StageData
    optimizer: VisibleAdam

    @property
    def gaussians(self) -> Gaussians:
        """Return the current model; its tensors may be changed in place."""

    @property
    def photos(self) -> PhotoViews:
        """Return the photos in full size."""

    def settled(self) -> bool:
        """Whether all steps so far are done; if not, the trainer has gone back to redo some."""

    def apply(self, edit: Edit) -> None:
        """Continue with other rows; all mechanisms follow."""

    def prune(self, context: Context, what: str, search: Callable[[], Tensor]) -> bool:
        """Remove the Gaussians that a search finds, (N,) bool; False if stopped before a change."""

    def render(
        self, optimizer: VisibleAdam, view: tuple[int, int | str], active: Mask, **options: Any
    ) -> RenderOutput:
        """Render an optimizer's Gaussians in a photo's view; `view` names photo and part."""


class Running:
    """A mechanism during training. All hooks do nothing by default; none needs gradients.

    Attributes:
        kept: names of attributes stored in checkpoints as its state: tensors and plain numbers.
        needs_max_weight: whether `observe` needs each Gaussian's largest blending weight.
        needs_surface: whether it has a `surface_loss`.
    """

    kept: tuple[str, ...] = ()
    needs_max_weight: bool = False
    needs_surface: bool = False

    def own_step(self, training: Training) -> tuple[int, Tensor] | None:
        """Replace the ordinary step by its own; return its photo and its loss, or None."""
        return None

    def mask(self, step: int, photo: int) -> LossMask | None:
        """Return the part of the photo that a step uses; None for the whole photo."""
        return None

    def row_rates(self, *, whole: bool) -> Tensor | None:
        """(N,) float32 factors on learning rates, for a step on a `whole` photo or not; None: 1."""
        return None

    def surface_loss(
        self, surface: Surface, alpha: Tensor, intrinsics: Tensor, weights: Tensor | None
    ) -> Tensor:
        """Return a term to add to the photo's loss, a scalar.

        Args:
            surface: of the part of the photo that the step uses, (1, H, W).
            alpha: of this part, (1, H, W).
            intrinsics: (3, 3) of this part.
            weights: (H, W) of its pixels; None for 1.
        """
        raise NotImplementedError

    def observe(self, visible: Tensor, grad2d: Tensor, max_weight: Tensor | None) -> None:
        """Receive the statistics of a step; all (N,), see `rasterize.RenderOutput`."""

    def is_due(self, step: int) -> bool:
        """Whether `after_step` does something after `step` steps; this must be cheap."""
        return False

    def after_step(self, training: Training) -> None:
        """Act after a step if `is_due`."""

    def between_steps(self, training: Training, context: Context) -> bool:
        """Act before a step; may take long. Return False if stopped without a change."""
        return True

    def end(self, training: Training, context: Context) -> bool:
        """Act after the last step; return False if stopped without a change."""
        return True

    def follow(self, rows: Tensor, gaussians: Gaussians) -> None:
        """Adapt to a model with other rows: (M,) the old row of each, -1 for new; and the model."""

    def state_dict(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.kept}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for name in self.kept:
            setattr(self, name, state[name])
