"""Hooks of training mechanisms: when the trainer calls them, and what they can access."""

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
        """The current model; its tensors may be changed in place."""

    @property
    def photos(self) -> PhotoViews:
        """The photos in full size."""

    def settled(self) -> bool:
        """Whether all steps so far are done; if not, the trainer has gone back to the first."""

    def apply(self, edit: Edit) -> None:
        """Continue with other rows; all mechanisms follow."""

    def prune(self, context: Context, what: str, search: Callable[[], Tensor]) -> bool:
        """Remove the Gaussians that a search finds, (N,) bool; False: stopped, nothing changed."""

    def render(
        self, optimizer: VisibleAdam, view: tuple[int, int | str], active: Mask, **options: Any
    ) -> RenderOutput:
        """An optimizer's Gaussians, on a photo of the step's size; `view` names photo and part."""


class Running:
    """A mechanism in a stage that trains. All hooks do nothing by default; none needs gradients.

    Attributes:
        kept: names of the attributes that are its state in checkpoints: tensors and plain numbers.
        needs_max_weight: whether `observe` needs each Gaussian's largest blending weight.
        needs_surface: whether it has a `surface_loss`.
    """

    kept: tuple[str, ...] = ()
    needs_max_weight: bool = False
    needs_surface: bool = False

    def own_step(self, training: Training) -> tuple[int, Tensor] | None:
        """Take this step in its own way; returns its photo and its loss, or None."""
        return None

    def mask(self, step: int, photo: int) -> LossMask | None:
        """The part of the photo that a step uses; None: all of it."""
        return None

    def row_rates(self, *, whole: bool) -> Tensor | None:
        """(N,) float32 factors of learning rates, in a step on a `whole` photo; None: all are 1."""
        return None

    def surface_loss(
        self, surface: Surface, alpha: Tensor, intrinsics: Tensor, weights: Tensor | None
    ) -> Tensor:
        """A term that a step adds to the photo's loss, a scalar.

        Args:
            surface: of the part of the photo that the step uses, (1, H, W).
            alpha: the same.
            intrinsics: (3, 3) of that part.
            weights: (H, W) of its pixels; None: 1.
        """
        raise NotImplementedError

    def observe(self, visible: Tensor, grad2d: Tensor, max_weight: Tensor | None) -> None:
        """Take the statistics of a step; all (N,), see `rasterize.RenderOutput`."""

    def is_due(self, step: int) -> bool:
        """Whether `after_step` does something after `step` steps; it costs nothing to ask."""
        return False

    def after_step(self, training: Training) -> None:
        """Act after a step, where `is_due`."""

    def between_steps(self, training: Training, context: Context) -> bool:
        """Act before a step, for longer; False: stopped, with nothing changed."""
        return True

    def end(self, training: Training, context: Context) -> bool:
        """Act after the last step; False: stopped, with nothing changed."""
        return True

    def follow(self, rows: Tensor, gaussians: Gaussians) -> None:
        """The model has other rows: (M,) the old row of each, -1: new; and the model itself."""

    def state_dict(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.kept}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for name in self.kept:
            setattr(self, name, state[name])
