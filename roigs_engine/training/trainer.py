"""The trainer of one stage. A resumed stage has the same bits as an uninterrupted one."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..context import QUIET, Context
from ..cuda.device import CPU, number, on_device
from ..errors import Stopped
from ..formats.events import Progress
from ..machine import release_freed_memory
from ..model.gaussians import NAMES, Gaussians
from ..rasterize import RenderOutput, rasterize
from ..rasterize.limits import training_limits
from ..rasterize.tiles import Mask
from .config import TrainConfig
from .edits import Edit, morton_order, unchanged
from .loop import PeriodicCallback, StepsAhead, explained_full_memory, one_torch_thread
from .loss_masks import LossMask, counted_weights, split_mask
from .losses import clipped_like, photo_loss
from .metrics import CHECK_EVERY, Health, TrainingMetrics
from .optimizer import VisibleAdam, leaves
from .stage_data import PhotoViews, StageData

REPORT_SECONDS = 0.5


class Trainer:
    """Optimises Gaussians on posed photos (Kerbl et al. 2023, with the paper's sec. II-B changes).

    All randomness is a function of (seed, step), so `state_dict` needs no random generator, and a
    trainer that loads it continues exactly.

    A step does not wait for its device: the running loss is read only when progress is shown. A
    view's buffer on a GPU that was too small is detected later (`StepsAhead`).
    """

    def __init__(
        self, gaussians: Gaussians, data: StageData, config: TrainConfig, context: Context = QUIET
    ) -> None:
        """Start at step 0 with a copy of `gaussians`; `context` is checked for cancellation."""
        self.config, self.data, self.context = config, data, context
        self.step = 0
        self.seconds = 0.0
        self.cpu_seconds = 0.0  # of all threads of the process
        # during training, each photo is drawn with its own pixels
        gaussians = replace(gaussians.to(data.device), target=config.target, photo_focal=None)
        self._gaussians = leaves(gaussians.rows(morton_order(gaussians.means)))
        self.optimizer = self._new_optimizer()
        self.health = Health([image.name for image in data.images])
        self.photos = PhotoViews(data, data.device, data.card_photos)
        self._ahead = StepsAhead(data.device)
        self._metrics = TrainingMetrics(data.device)
        self._steps_before = 0  # of the optimizer, before this step
        acting = [each for each in config.mechanisms if each.acts(config)]
        self._running = {each.name: each.begin(config, self) for each in acting}

    @property
    def gaussians(self) -> Gaussians:
        """Return the current model; its tensors belong to the trainer."""
        _ = self.optimizer.parameters  # copies them back from a GPU that torch does not know
        return self._gaussians

    def run(
        self,
        context: Context = QUIET,
        *,
        stage: str = "",
        callbacks: Sequence[PeriodicCallback] = (),
    ) -> bool:
        """Train to the config's last step, with mechanisms; return False if stopped earlier.

        Args:
            context: receives progress events, at most two per second; checked for cancellation
                before every step, and during the work of mechanisms.
            stage: the stage's name in progress events.
            callbacks: called between steps to write checkpoints and previews.
        """
        explained = explained_full_memory(
            self.data.images, lambda: (self.step, len(self._gaussians))
        )
        with one_torch_thread(), explained:
            return self._run(context, stage, callbacks)

    def _run(self, context: Context, stage: str, callbacks: Sequence[PeriodicCallback]) -> bool:
        started = reported = time.perf_counter()
        before, first = self.seconds, self.step
        cpu_started = time.process_time() - self.cpu_seconds
        while self.step < self.config.steps:
            if context.should_stop():
                break
            with torch.no_grad():
                if not all(each.between_steps(self, context) for each in self._running.values()):
                    break
            self.train_step()
            now = time.perf_counter()
            self.seconds = before + now - started
            self.cpu_seconds = time.process_time() - cpu_started
            if now - reported > REPORT_SECONDS or self.step == self.config.steps:
                reported = now
                done = max(self.step - first, 1)
                left = (now - started) / done * (self.config.steps - self.step)
                context.emit(
                    Progress(
                        stage=stage,
                        step=self.step,
                        total=self.config.steps,
                        loss=float(self._metrics.loss),
                        psnr=self._metrics.psnr,
                        gaussians=len(self._gaussians),
                        seconds_left=left,
                    )
                )
            for callback in callbacks:
                # Writing files does not count as training time.
                started += callback.call_if_due(self.seconds)
            cpu_started = time.process_time() - self.cpu_seconds
        if self.step < self.config.steps:
            return False
        with torch.no_grad():
            return all(each.end(self, context) for each in self._running.values())

    def train_step(self) -> None:
        """Render a photo, compare it, take an optimizer step, then let mechanisms act."""
        config, data = self.config, self.data
        self._ahead.begin(self.step, self._metrics.loss)
        self._steps_before = self.optimizer.step_count
        self.optimizer.set_lr("means", config.position_learning_rate(self.step) * data.extent)
        own = (each.own_step(self) for each in self._running.values())
        if taken := next((step for step in own if step is not None), None):
            self._end_step(*taken)
            return
        index = data.photo_at(self.step)
        for step in (self.step + 1, self.step + 2):
            self.photos.prefetch(data.photo_at(step))
        photo, counted = split_mask(self.photos.photo(index))
        mask = self._mask(index)
        self.optimizer.row_rates = self._row_rates(whole=mask is None)
        output = self._render(index, mask, counted)
        # squeeze, not [0]: its gradient is a view, that of an index is a copy into zeros
        image, weights = clipped_like(output.image.squeeze(0), data.images[index]), None
        if mask is not None:
            photo = mask.crop(photo)
            counted = None if counted is None else mask.crop(counted)
            weights = mask.weights
        loss = photo_loss(
            image, photo, ssim_weight=config.ssim_weight, weights=weights, counted=counted
        )
        # A pixel weighs about as much as in a whole photo: gradient thresholds keep their meaning.
        loss_weight = None if mask is None else number(mask.loss_weight, data.device)
        if counted is not None:
            weights, share = counted_weights(weights, counted)
            loss_weight = share if loss_weight is None else loss_weight * share
        whole = loss.loss + self._surface_loss(index, output, mask, weights)
        # As a factor: a weight given to backward() makes torch import sympy, for half a second.
        weighted = whole if loss_weight is None else whole * loss_weight
        weighted.backward()  # type: ignore[no-untyped-call]
        visible = output.visible[0]
        with torch.no_grad():
            for each in self._running.values():
                each.observe(visible, output.grad2d[0], output.max_weight)
        value = loss.loss.detach()
        self._metrics.observe(self.step, value, (image, photo), weights)
        self._end_step(index, value)

    def _row_rates(self, *, whole: bool) -> Tensor | None:
        found = [each.row_rates(whole=whole) for each in self._running.values()]
        factors = [rates for rates in found if rates is not None]
        return reduce(torch.mul, factors) if factors else None

    def _end_step(self, index: int, loss: Tensor) -> None:
        """Count a step on a photo, check for NaN, and let mechanisms act."""
        self.health.record_loss(self.step, index, loss)
        self.step += 1
        due = [each for each in self._running.values() if each.is_due(self.step)]
        checks, ends = self.step % CHECK_EVERY == 0 or bool(due), self.step == self.config.steps
        if self._taken_back(wait=checks or ends or self._metrics.is_new):
            return
        self._metrics.read()
        if checks:
            self.check()
        with torch.no_grad():
            for each in due:
                each.after_step(self)

    def settled(self) -> bool:
        """See `Training`."""
        return not self._taken_back(wait=True)

    def _taken_back(self, *, wait: bool) -> bool:
        """Whether steps must be done again; if so, go back to the first of them."""
        found = self._ahead.first_void(wait=wait)
        if found is None:
            return False
        step, loss = found
        self._metrics.take_back(loss)
        self.optimizer.step_count -= self.step - step
        self.health.forget(step)
        self.step = step
        return True

    @property
    def is_between_steps(self) -> bool:
        """Whether a failed step has changed nothing, so the state is that before it."""
        return self.optimizer.step_count == self._steps_before

    def check(self) -> None:
        """Raise TrainingError if a loss, a gradient or a parameter is NaN or Inf."""
        self._taken_back(wait=True)
        self.health.check(self.step, self.gaussians.tensors(), self.optimizer.skipped_rows)

    def _mask(self, index: int) -> LossMask | None:
        """Return the mask of this step's photo; None if the step uses the whole photo."""
        found = (each.mask(self.step, index) for each in self._running.values())
        return next((mask for mask in found if mask is not None), None)

    def _render(self, index: int, mask: LossMask | None, counted: Tensor | None) -> RenderOutput:
        active: Mask = None if mask is None else mask.tiles
        if counted is not None:
            active = counted if mask is None else mask.counting(counted)
        colours, view = self.data.backgrounds, (index, "whole" if mask is None else "mask")
        return self.render(
            self.optimizer,
            view,
            active,
            background=None if colours is None else colours[index],
            with_max_weight=any(each.needs_max_weight for each in self._running.values()),
            with_surface=any(each.needs_surface for each in self._running.values()),
        )

    def _surface_loss(
        self, index: int, output: RenderOutput, mask: LossMask | None, weights: Tensor | None
    ) -> Tensor | float:
        """Return the sum of the mechanisms' surface losses."""
        if output.surface is None:
            return 0.0
        intrinsics = self.photos.view(index).Ks[0].clone()
        if mask is not None:
            x0, y0, _, _ = mask.tiles.shown
            intrinsics[0, 2] -= x0
            intrinsics[1, 2] -= y0
        given = output.surface, output.alpha, intrinsics, weights
        own = (each for each in self._running.values() if each.needs_surface)
        return reduce(torch.add, (each.surface_loss(*given) for each in own))

    def render(
        self, optimizer: VisibleAdam, view: tuple[int, int | str], active: Mask, **options: Any
    ) -> RenderOutput:
        """Render an optimizer's Gaussians, all or a part; `options` are for `rasterize`."""
        camera = self.photos.view(view[0])
        taken = self._ahead.backward_step(optimizer, self.step, (*view, camera.width))
        means, quats, scales, opacities, sh = taken.tensors
        return rasterize(
            means,
            quats,
            scales,
            opacities,
            sh,
            **camera._asdict(),
            sh_degree=self.config.degree(self.step),
            raw=True,
            **self.config.target.drawing,
            limits=training_limits(self.step, linear_light=self.config.target.linear_light),
            mask=active,
            backward_step=taken,
            **options,
        )

    def prune(self, context: Context, what: str, search: Callable[[], Tensor]) -> bool:
        """See `Training`."""
        began, cpu_began = time.perf_counter(), time.process_time()
        context.info(f"Looking for {what}.")
        self._steps_before = self.optimizer.step_count  # the search changes nothing
        try:
            found = search()
        except Stopped:
            return False
        context.info(f"Removed {int(found.sum()):,} {what}, of {len(found):,}.")
        if bool(found.any()):
            self._steps_before = -1  # from here on, the state may be half changed
            kept = (~found).nonzero()[:, 0]
            self.apply(unchanged(self.gaussians).keep(kept))
            self._steps_before = self.optimizer.step_count
        self.seconds += time.perf_counter() - began
        self.cpu_seconds += time.process_time() - cpu_began
        return True

    def apply(self, edit: Edit) -> None:
        if edit.rows is not None:
            self._ahead.grow(len(self._gaussians), len(edit.rows))
            self._gaussians = leaves(edit.gaussians)
            self.optimizer.replace(self._gaussians.tensors(), edit.rows)
            for each in self._running.values():
                each.follow(edit.rows, self._gaussians)
            release_freed_memory()
        if edit.opacity_cap is not None:
            logit = float(np.log(edit.opacity_cap / (1 - edit.opacity_cap)))
            with torch.no_grad():
                self.gaussians.logit_opacities.clamp_(max=logit)
            self.optimizer.zero_moments("logit_opacities")

    def _new_optimizer(self) -> VisibleAdam:
        tensors = self._gaussians.tensors()
        rates = learning_rates(self.config, self.data.extent, tensors["sh"].shape[1])
        return VisibleAdam({name: (tensors[name], rates[name]) for name in NAMES})

    def state_dict(self) -> dict[str, Any]:
        """Return the complete training state: tensors on the CPU and plain numbers."""
        self._taken_back(wait=True)
        state = {
            "step": self.step,
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
            "loss": float(self._metrics.loss),
            "psnr": self._metrics.psnr,
            "parameters": {n: t.detach() for n, t in self.gaussians.tensors().items()},
            "optimizer": self.optimizer.state_dict(),
            "mechanisms": {name: each.state_dict() for name, each in self._running.items()},
        }
        return dict(on_device(state, CPU))

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a `state_dict`, which may come from another device."""
        state = on_device(state, self.data.device)
        self.step, self.seconds = int(state["step"]), float(state["seconds"])
        self.cpu_seconds = float(state["cpu_seconds"])
        self._metrics.loss.fill_(float(state["loss"]))
        self._metrics.psnr = float(state["psnr"])
        self._gaussians = leaves(self._gaussians.with_tensors(state["parameters"]))
        self.optimizer = self._new_optimizer()
        self.optimizer.load_state_dict(state["optimizer"])
        for name, each in self._running.items():
            each.load_state_dict(state["mechanisms"][name])


def learning_rates(config: TrainConfig, extent: float, bands: int) -> dict[str, float | Tensor]:
    """Return the learning rate of each of `Gaussians`' tensors at the first step; `bands` of SH."""
    sh = torch.full((bands, 3), config.lr_shN)
    sh[0] = config.lr_sh0
    return {
        "means": config.lr_means * extent,
        "quats": config.lr_quats,
        "log_scales": config.lr_scales,
        "logit_opacities": config.lr_opacities,
        "sh": sh.flatten(),
    }
