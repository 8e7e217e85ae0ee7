"""Trains the Gaussians of one stage; a resumed stage gives the same bits as an unstopped one."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..context import QUIET, Context
from ..cuda.device import CPU, number, on_device, sent
from ..errors import Stopped
from ..machine import release_freed_memory
from ..model.gaussians import NAMES, Gaussians
from ..rasterize import RenderOutput, rasterize
from ..rasterize.limits import TRAINING_LIMITS
from ..rasterize.tiles import Mask
from . import full_memory
from .averaging import ModelMean
from .callbacks import PeriodicCallback
from .config import TrainConfig
from .cutouts import Cutout
from .densification import Edit, density_control
from .densification.edits import unchanged
from .faint import faint_gaussians
from .figures import Figures
from .floaters import floaters
from .health import CHECK_EVERY, Health
from .losses import photo_loss
from .masks import RoiMask, counted_weights, split_mask
from .opacity_decay import decay_opacities
from .optimizer import VisibleAdam, learning_rates, leaves
from .outside import outside_boxes, row_decay, row_rates
from .photo_order import is_whole
from .photo_views import PhotoViews
from .stage_data import StageData
from .steps_ahead import StepsAhead
from .threads import one_torch_thread
from .z_order import morton_order

REPORT_SECONDS = 0.5


class Trainer:
    """Optimises Gaussians on posed photos (Kerbl et al. 2023, with the paper's sec. II-B changes).

    Everything random is a function of (seed, step), so `state_dict` needs no random generator, and
    a trainer that loads it continues exactly.

    A step does not wait for its device: the running loss is read only when progress is shown, and
    that a view's buffer on a GPU was too small is heard of later (`StepsAhead`).
    """

    def __init__(self, gaussians: Gaussians, data: StageData, config: TrainConfig) -> None:
        """Start at step 0 with a copy of `gaussians`."""
        self.config = config
        self.data = data
        self.step = 0
        self.seconds = 0.0
        self.cpu_seconds = 0.0  # of the whole process, all its threads
        gaussians = replace(gaussians.to(data.device), antialiased=config.antialiased)
        self._parameters = leaves(gaussians.rows(morton_order(gaussians.means)))
        self._optimizer = self._new_optimizer()
        self._density = density_control(data.density_inputs(config), len(gaussians))
        self._outside = outside_boxes(self._parameters, data.rois, config)
        self._mean = ModelMean()
        self._faint_pruned = False
        self.health = Health([image.name for image in data.images])
        small = data.small if config.has_small else None
        self._small = None if small is None else PhotoViews(small, data.device, data.card_photos)
        self._whole = PhotoViews(data, data.device, data.card_photos)
        self._ahead = StepsAhead(data.device)
        self._figures = Figures(data.device)
        self._steps_before = 0  # of the optimizer, in front of this step

    @property
    def gaussians(self) -> Gaussians:
        """The current model; its tensors belong to the trainer."""
        return self._parameters

    def run(
        self,
        context: Context = QUIET,
        *,
        stage: str = "",
        callbacks: Sequence[PeriodicCallback] = (),
    ) -> bool:
        """Train to the config's last step, then prune floaters; False if stopped earlier.

        Between two steps, when densification has ended, it prunes faint Gaussians.

        Args:
            context: receives progress events, at most two per second; checked for cancellation
                before every step, and while it prunes.
            stage: the stage's name in progress events.
            callbacks: called between steps to write checkpoints and previews.
        """
        explained = full_memory.explained(
            self.data.images, lambda: (self.step, len(self._parameters))
        )
        with one_torch_thread(), explained:
            return self._run(context, stage, callbacks)

    def _run(self, context: Context, stage: str, callbacks: Sequence[PeriodicCallback]) -> bool:
        started = reported = time.perf_counter()
        before, first = self.seconds, self.step
        cpu_started = time.process_time() - self.cpu_seconds
        while self.step < self.config.steps:
            if context.should_stop() or not self._without_faint(context):
                break
            self.train_step()
            now = time.perf_counter()
            self.seconds = before + now - started
            self.cpu_seconds = time.process_time() - cpu_started
            if now - reported > REPORT_SECONDS or self.step == self.config.steps:
                reported = now
                done = max(self.step - first, 1)
                left = (now - started) / done * (self.config.steps - self.step)
                where = stage, self.step, self.config.steps, len(self._parameters)
                context.emit(self._figures.progress(*where, left))
            for callback in callbacks:
                # Writing files does not count as training time.
                started += callback.call_if_due(self.seconds)
            cpu_started = time.process_time() - self.cpu_seconds
        if self.step < self.config.steps:
            return False
        return self._without_floaters(context)

    def train_step(self) -> None:
        """Render a photo, compare, take an optimizer step, then densify or prune if it is due."""
        config, data = self.config, self.data
        self._ahead.begin(self.step, self._figures.loss)
        self._steps_before = self._optimizer.step_count
        self._optimizer.set_lr("means", config.position_learning_rate(self.step) * data.extent)
        cutout = None if data.cutouts is None else data.cutouts.at(self.step)
        if cutout is not None:
            self._cutout_step(cutout)
            return
        index = data.photo_at(self.step)
        for step in (self.step + 1, self.step + 2):
            self._views(step).prefetch(data.photo_at(step))
        target, counted = split_mask(self._views(self.step).photo(index))
        mask = self._mask(index)
        rates = row_rates(self._outside, config.outside_rate, whole=mask is None)
        self._optimizer.row_rates = rates
        output = self._render(index, mask, counted)
        # squeeze, not [0]: its gradient is a view, that of an index is a copy into zeros
        image, weights = output.image.squeeze(0), None
        if mask is not None:
            target = mask.crop(target)
            counted = None if counted is None else mask.crop(counted)
            weights = mask.weights
        loss = photo_loss(
            image, target, ssim_weight=config.ssim_weight, weights=weights, counted=counted
        )
        # A pixel weighs about as much as in a whole photo: gradient thresholds keep their meaning.
        loss_weight = None if mask is None else number(mask.loss_weight, data.device)
        if counted is not None:
            weights, share = counted_weights(weights, counted)
            loss_weight = share if loss_weight is None else loss_weight * share
        loss.loss.backward(loss_weight)  # type: ignore[no-untyped-call]
        visible = output.visible[0]
        if self._optimizer.backward_step is None:
            self._optimizer.step(visible)
        self._density.observe(visible, output.grad2d[0], output.max_weight)
        value = loss.loss.detach()
        self._figures.observe(self.step, value, (image, target), weights)
        self._end_step(index, value)

    def _cutout_step(self, cutout: Cutout) -> None:
        """Draw an object alone, compare, and take an optimizer step with its Gaussians."""
        target, _ = split_mask(self._whole.photo(cutout.photo))
        part = self._optimizer.part(cutout.rows)
        view = cutout.photo, cutout.box
        output = self._rendered(part, view, cutout.counted, background=cutout.background)
        window = cutout.window()
        loss = photo_loss(
            output.image.squeeze(0)[window],
            cutout.target(target)[window],
            ssim_weight=self.config.ssim_weight,
            counted=sent(cutout.counted[window], target.device),
        )
        weight = number(cutout.loss_weight, target.device)
        loss.loss.backward(weight)  # type: ignore[no-untyped-call]
        if part.backward_step is None:
            part.step(output.visible[0])
        self._optimizer.put(part, cutout.rows)
        self._end_step(cutout.photo, loss.loss.detach())

    def _end_step(self, index: int, loss: Tensor) -> None:
        """Count a step on a photo, look for NaN; edit the model and restart Adam if it is due."""
        self.health.record_loss(self.step, index, loss)
        self.step += 1
        checks = self.step % min(CHECK_EVERY, self.config.densify_every) == 0
        edits, averages = self._density.is_due(self.step), self.config.is_averaged(self.step)
        restarts, ends = self.config.is_restarted(self.step), self.step == self.config.steps
        decays = self.config.is_decayed(self.step, len(self.data.images))
        reads = any((checks, edits, averages, restarts, decays, ends, self._figures.is_new))
        if self._taken_back(wait=reads):
            return
        self._figures.read()
        if checks:
            self.check()
        if edits and (edit := self._density.edit(self._parameters, self.step)) is not None:
            self._apply(edit)
        if restarts:
            self._optimizer.zero_moments(*(name for name in NAMES if name != "sh"))
        self._average()
        if decays:
            share = row_decay(self._outside, self.config)
            decay_opacities(self._parameters.logit_opacities, share)

    def _taken_back(self, *, wait: bool) -> bool:
        """Whether steps must be done again; then the trainer is where the first of them begins."""
        found = self._ahead.first_void(wait=wait)
        if found is None:
            return False
        step, loss = found
        self._figures.take_back(loss)
        self._optimizer.step_count -= self.step - step
        self.health.forget(step)
        self.step = step
        return True

    @property
    def is_between_steps(self) -> bool:
        """Whether a step that failed has changed nothing: the state is that in front of it."""
        return self._optimizer.step_count == self._steps_before

    def check(self) -> None:
        """Raise TrainingError if a loss, a gradient or a parameter is NaN or Inf."""
        self._taken_back(wait=True)
        self.health.check(self.step, self._parameters.tensors(), self._optimizer.skipped_rows)

    def _views(self, step: int) -> PhotoViews:
        """The photos in the size that a step uses."""
        return (self._small if self.config.is_small(step) else None) or self._whole

    def _mask(self, index: int) -> RoiMask | None:
        """The mask of this step's photo; None: the step uses the whole photo."""
        if is_whole(self.step, self.config.full_every):
            return None
        return self._views(self.step).mask(index)

    def _render(self, index: int, mask: RoiMask | None, counted: Tensor | None) -> RenderOutput:
        active: Mask = None if mask is None else mask.tiles
        if counted is not None:
            active = counted if mask is None else mask.counting(counted)
        colours, needed = self.data.backgrounds, self._density.needs_max_weight
        behind = None if colours is None else colours[index]
        view = index, "whole" if mask is None else "mask"
        options: dict[str, Any] = {"background": behind, "with_max_weight": needed}
        return self._rendered(self._optimizer, view, active, **options)

    def _rendered(
        self,
        optimizer: VisibleAdam,
        view: tuple[int, int | str],
        active: Mask,
        **options: Any,
    ) -> RenderOutput:
        """An optimizer's Gaussians.

        Args:
            view: the photo, and what is drawn of it.
            active: what is needed of it.
        """
        p, camera = optimizer.parameters, self._views(self.step).view(view[0])
        return rasterize(
            p["means"],
            p["quats"],
            p["log_scales"],
            p["logit_opacities"],
            p["sh"],
            **camera._asdict(),
            sh_degree=self.config.degree(self.step),
            raw=True,
            antialiased=self.config.antialiased,
            limits=TRAINING_LIMITS,
            mask=active,
            backward_step=self._ahead.backward_step(optimizer, self.step, (*view, camera.width)),
            **options,
        )

    def _average(self) -> None:
        """Add the model to the mean; at the last step, the mean becomes the model."""
        if self.config.is_averaged(self.step):
            self._mean.add(self._parameters)
        if self.step == self.config.steps and self._mean.count:
            self._parameters = leaves(self._parameters.with_tensors(self._mean.mean()))
            self._mean.clear()

    def _without_faint(self, context: Context) -> bool:
        """Prune the faintest Gaussians if that is due; False if stopped, with nothing changed."""
        config = self.config
        due = config.prunes_faint and config.densify_until <= self.step and not self._faint_pruned
        if not due or self._taken_back(wait=True):
            return True
        asked = self.data, self._whole, config.faint_growth
        what = "Gaussians that the photos hardly show"
        self._faint_pruned = self._prune(context, what, faint_gaussians, *asked)
        return self._faint_pruned

    def _without_floaters(self, context: Context) -> bool:
        """Prune floaters if the stage does; False if stopped, with nothing changed."""
        data, views = self.data, self.config.min_views
        asked = data.images, data.rois, data.points, views
        what = "Gaussians that hang in the air"
        return not views or self._prune(context, what, floaters, *asked)

    def _prune(
        self, context: Context, what: str, search: Callable[..., Tensor], *asked: Any
    ) -> bool:
        """Remove the Gaussians that a search finds, (N,) bool; False if it was stopped."""
        began, cpu_began = time.perf_counter(), time.process_time()
        context.info(f"Looking for {what}.")
        self._steps_before = self._optimizer.step_count  # while it searches, nothing has changed
        try:
            found = search(self._parameters, *asked, context)
        except Stopped:
            return False
        context.info(f"Removed {int(found.sum()):,} {what}, of {len(found):,}.")
        if bool(found.any()):
            self._steps_before = -1  # from here on, half of the state may have
            kept = (~found).nonzero()[:, 0]
            self._density.follow(kept)
            self._apply(unchanged(self._parameters).keep(kept))
            self._steps_before = self._optimizer.step_count
        self.seconds += time.perf_counter() - began
        self.cpu_seconds += time.process_time() - cpu_began
        return True

    def _apply(self, edit: Edit) -> None:
        """Continue with the edited Gaussians and their optimizer state."""
        if edit.rows is not None:
            self._ahead.grow(len(self._parameters), len(edit.rows))
            self._mean.clear()
            self._parameters = leaves(edit.gaussians)
            self._optimizer.replace(self._parameters.tensors(), edit.rows)
            self._outside = outside_boxes(self._parameters, self.data.rois, self.config)
            release_freed_memory()
        if edit.opacity_cap is not None:
            logit = float(np.log(edit.opacity_cap / (1 - edit.opacity_cap)))
            with torch.no_grad():
                self._parameters.logit_opacities.clamp_(max=logit)
            self._optimizer.zero_moments("logit_opacities")

    def _new_optimizer(self) -> VisibleAdam:
        tensors = self._parameters.tensors()
        rates = learning_rates(self.config, self.data.extent, tensors["sh"].shape[1])
        return VisibleAdam({name: (tensors[name], rates[name]) for name in NAMES}, fused=True)

    def state_dict(self) -> dict[str, Any]:
        """The complete training state: tensors on the CPU and plain numbers."""
        self._taken_back(wait=True)
        state = {
            "step": self.step,
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
            "loss": float(self._figures.loss),
            "psnr": self._figures.psnr,
            "parameters": {n: t.detach() for n, t in self._parameters.tensors().items()},
            "optimizer": self._optimizer.state_dict(),
            "mean": self._mean.state_dict(),
            "density": self._density.state_dict(),
            "faint_pruned": self._faint_pruned,
            "outside": self._outside,
        }
        return dict(on_device(state, CPU))

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a `state_dict`, which may come from another device."""
        state = on_device(state, self.data.device)
        self.step, self.seconds = int(state["step"]), float(state["seconds"])
        self.cpu_seconds = float(state["cpu_seconds"])
        self._figures.loss.fill_(float(state["loss"]))
        self._figures.psnr = float(state["psnr"])
        self._parameters = leaves(self._parameters.with_tensors(state["parameters"]))
        self._optimizer = self._new_optimizer()
        self._optimizer.load_state_dict(state["optimizer"])
        self._mean.load_state_dict(state["mean"])
        inputs = self.data.density_inputs(self.config)
        self._density = density_control(inputs, len(self._parameters))
        self._density.load_state_dict(state["density"])
        self._outside = state.get("outside")  # an older checkpoint has none
        self._faint_pruned = bool(state.get("faint_pruned"))  # None: an older checkpoint
