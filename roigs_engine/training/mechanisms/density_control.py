"""3DGS's adaptive density control (Kerbl et al. 2023, sec. 5.2)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from ..config import Mechanism, TrainConfig, interval, share_of_steps
from ..running import Running

if TYPE_CHECKING:
    from torch import Tensor

    from ...model.gaussians import Gaussians
    from ..edits import Edit
    from ..running import Training
    from ..state_reader import StateReader

RESET_OPACITY = 0.01


@dataclass(frozen=True, kw_only=True)
class DensityControl(Mechanism):
    """Clones and splits Gaussians with large gradients, prunes transparent and huge ones (3DGS).

    Earns: not measured alone; every other mechanism was measured with it.

    Attributes:
        start, until, every: steps.
        grad_threshold: mean 2D gradient above which a Gaussian is cloned or split.
        split_fraction: a Gaussian larger than this share of the size reference is split.
        prune_opacity: Gaussians below this opacity are removed whenever others are added.
        prune_size: so are Gaussians above this share of the scene extent, after the first opacity
            reset.
        reset_every: steps between opacity resets to 0.01 while it adds Gaussians; 0 for none.
    """

    name: ClassVar[str] = "density_control"

    start: int = interval(500)
    until: int = share_of_steps(15_000)
    every: int = interval(100, least=1)
    grad_threshold: float = 2e-4
    split_fraction: float = 0.01
    prune_opacity: float = 0.005
    prune_size: float = 0.1
    reset_every: int = interval(3000)

    def grows(self, step: int) -> bool:
        """Whether Gaussians are added after `step` steps."""
        return self.start <= step < self.until and step % self.every == 0

    def resets(self, step: int) -> bool:
        """Whether opacities are reset after `step` steps."""
        reset = self.reset_every > 0 and step % self.reset_every == 0
        return reset and self.start <= step < self.until

    def ends_within(self, config: TrainConfig) -> bool:
        """Whether a stage adds Gaussians, and continues after that."""
        first = -(-max(self.start, 1) // self.every) * self.every
        return first < self.until < config.steps

    def acts(self, config: TrainConfig) -> bool:
        return self.until > self.start

    def begin(self, config: TrainConfig, training: Training) -> RunningDensityControl:
        return RunningDensityControl(self, training)

    def check_state(self, state: StateReader) -> None:
        state.tensors(dict.fromkeys(("gradient", "views"), state.rows), least=0.0)


class RunningDensityControl(Running):
    """Statistics of each Gaussian; subclasses override the mask and the size reference."""

    kept: tuple[str, ...] = ("gradient", "views")

    def __init__(self, settings: DensityControl, training: Training) -> None:
        self.settings, self.data = settings, training.data
        # (N,) sums over training views since the last edit: of norms of 2D gradients, of views.
        self.gradient = training.gaussians.logit_opacities.detach().new_zeros(
            len(training.gaussians)
        )
        self.views = self.gradient.clone()

    def observe(self, visible: Tensor, grad2d: Tensor, max_weight: Tensor | None) -> None:
        self.gradient += grad2d
        self.views += visible

    def is_due(self, step: int) -> bool:
        return self.settings.grows(step) or self.settings.resets(step)

    def after_step(self, training: Training) -> None:
        if (edit := self.edit(training.gaussians, training.step)) is not None:
            training.apply(edit)

    def edit(self, gaussians: Gaussians, step: int) -> Edit | None:
        """Return the edit that is due after `step` steps; None if none is."""
        from ..edits import Edit

        edit = Edit(gaussians=gaussians, rows=None)
        if self.settings.grows(step):
            edit = self._densified(gaussians, step)
        if self.settings.resets(step):
            edit = replace(edit, opacity_cap=RESET_OPACITY)
        return None if edit.rows is None and edit.opacity_cap is None else edit

    def follow(self, rows: Tensor, gaussians: Gaussians) -> None:
        self.gradient, self.views = (self.gradient.new_zeros(len(rows)) for _ in range(2))

    def mean_gradient(self) -> Tensor:
        """(N,) mean gradient norm over the views that showed each Gaussian."""
        return self.gradient / self.views.clamp(min=1)

    def densify_mask(self, gaussians: Gaussians, step: int) -> Tensor:
        """(N,) bool: which Gaussians to clone or split."""
        return self.mean_gradient() > self.settings.grad_threshold

    def size_reference(self, gaussians: Gaussians) -> Tensor:
        """(N,) the length that `split_fraction` is relative to: the scene's extent."""
        import torch

        device = gaussians.means.device
        return torch.full((len(gaussians),), self.data.extent, device=device)

    def _densified(self, gaussians: Gaussians, step: int) -> Edit:
        import torch

        from ..edits import clone_and_split, morton_order

        rng = torch.Generator().manual_seed(self.data.seed * 1_000_003 + step)
        mask, reference = self.densify_mask(gaussians, step), self.size_reference(gaussians)

        def choose(edited: Gaussians) -> Tensor:
            rows = self.prune_mask(edited, step).logical_not().nonzero()[:, 0]
            return rows[morton_order(edited.means[rows])]

        fraction = self.settings.split_fraction
        return clone_and_split(gaussians, mask, reference, fraction, rng, choose)

    def prune_mask(self, gaussians: Gaussians, step: int) -> Tensor:
        """(N,) bool: too transparent or, after the first opacity reset, too large in the world."""
        settings = self.settings
        keep = gaussians.logit_opacities.detach().sigmoid() >= settings.prune_opacity
        if settings.reset_every and step > settings.reset_every:
            largest = gaussians.log_scales.detach().exp().amax(dim=1)
            keep &= largest <= settings.prune_size * self.data.extent
        return ~keep
