"""Trains the Gaussians of one stage; a resumed stage gives the same bits as an unstopped one."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..context import QUIET, Context
from ..cuda.device import CPU, on_device
from ..cuda.memory import explain_out_of_memory, smaller_side
from ..cuda.photos import Photos, photos_on
from ..errors import Stopped
from ..formats.events import Progress
from ..machine import release_freed_memory
from ..model.gaussians import NAMES, Gaussians
from ..model.roi import OrientedBox
from ..model.scene import Float64, PosedImage
from ..rasterize import RenderOutput, rasterize
from .averaging import ModelMean
from .budget import BoxBudget
from .callbacks import PeriodicCallback
from .config import TrainConfig
from .densification import DensityControl, DensityInputs, Edit, density_control
from .densification.edits import unchanged
from .floaters import floaters
from .health import CHECK_EVERY, Health
from .losses import photo_loss
from .masks import RoiMask, RoiMasks, counted_weights, split_mask
from .optimizer import VisibleAdam
from .photo_order import PhotoAt, is_whole
from .z_order import morton_order

REPORT_SECONDS = 0.5
AVERAGE_EVERY = 10  # steps between the models that are averaged: consecutive ones hardly differ
PSNR_EVERY = 50  # steps
RECENT = 0.98  # weight of the past in the running loss that progress shows


@dataclass(frozen=True, kw_only=True, eq=False)
class StageData:
    """The data that a stage trains on.

    Attributes:
        images: posed photos.
        photos: their pixels, in the same order.
        photo_at: step -> position in `images` of the photo that the step uses.
        extent: the *scene's* extent, world units; scales position learning rates and pruning sizes.
        rois: boxes that limit densification, if the stage's config says so.
        budgets: Gaussian budget of each box; None: no limit.
        masks: masks for the steps that do not use whole photos (`config.full_every`).
        points: (P, 3) of the scene, world units; used with `config.min_views`.
        backgrounds: (P,) grey behind all Gaussians in each photo, from 0 to 1; None: black.
        seed: for the positions of split Gaussians.
        device: where to train; devices differ only in rounding.
    """

    images: Sequence[PosedImage]
    photos: Photos
    photo_at: PhotoAt
    extent: float
    rois: Sequence[OrientedBox] = ()
    budgets: Sequence[BoxBudget] | None = None
    masks: RoiMasks | None = None
    points: Float64 = field(default_factory=lambda: np.zeros((0, 3)))
    backgrounds: Tensor | None = None
    seed: int = 0
    device: torch.device = CPU


class Trainer:
    """Optimises Gaussians on posed photos (Kerbl et al. 2023, with the paper's sec. II-B changes).

    Everything random is a function of (seed, step), so `state_dict` needs no random generator, and
    a trainer that loads it continues exactly.

    A step does not wait for its device: the running loss is read only when progress is shown.
    """

    def __init__(self, gaussians: Gaussians, data: StageData, config: TrainConfig) -> None:
        """Start at step 0 with a copy of `gaussians`."""
        self.config = config
        self.data = data
        self.step = 0
        self.seconds = 0.0
        self.cpu_seconds = 0.0  # of the whole process, all its threads
        gaussians = gaussians.to(data.device)
        self._parameters = _leaves(gaussians.rows(morton_order(gaussians.means)))
        self._optimizer = self._new_optimizer()
        self._density = self._new_density(len(gaussians))
        self._mean = ModelMean()
        self.health = Health([image.name for image in data.images])
        self._photos = photos_on(data.device, data.photos)
        self._viewmats, self._intrinsics = _cameras(data.images, data.device)
        self._loss = torch.tensor(torch.nan, device=data.device)
        self._psnr = float("nan")

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

        Args:
            context: receives progress events, at most two per second; checked for cancellation
                before every step.
            stage: the stage's name in progress events.
            callbacks: called between steps to write checkpoints and previews.
        """
        with one_torch_thread(), explain_out_of_memory(self._doing, self._advice):
            return self._run(context, stage, callbacks)

    def _run(self, context: Context, stage: str, callbacks: Sequence[PeriodicCallback]) -> bool:
        started = reported = time.perf_counter()
        before, first = self.seconds, self.step
        cpu_started = time.process_time() - self.cpu_seconds
        while self.step < self.config.steps:
            if context.should_stop():
                break
            self.train_step()
            now = time.perf_counter()
            self.seconds = before + now - started
            self.cpu_seconds = time.process_time() - cpu_started
            if now - reported > REPORT_SECONDS or self.step == self.config.steps:
                reported = now
                left = (now - started) / (self.step - first) * (self.config.steps - self.step)
                context.emit(self._progress(stage, left))
            for callback in callbacks:
                # Writing files does not count as training time.
                started += callback.call_if_due(self.seconds)
            cpu_started = time.process_time() - self.cpu_seconds
        if self.step < self.config.steps:
            return False
        return not self.config.min_views or self._prune_floaters(context)

    def train_step(self) -> None:
        """Render a photo, compare, take an optimizer step, then densify or prune if it is due."""
        config, data = self.config, self.data
        index = data.photo_at(self.step)
        self._photos.prefetch([data.photo_at(self.step + ahead) for ahead in (1, 2)])
        target, counted = split_mask(self._photos[index])
        self._optimizer.set_lr("means", config.position_learning_rate(self.step) * data.extent)
        mask = self._mask(index)
        output = self._render(index, mask, counted)
        # squeeze, not [0]: its gradient is a view, that of an index is a copy into zeros
        image, weights = output.image.squeeze(0), None
        if mask is not None:
            image, target = mask.crop(image), mask.crop(target)
            counted = None if counted is None else mask.crop(counted)
            weights = mask.weights
        loss = photo_loss(
            image, target, ssim_weight=config.ssim_weight, weights=weights, counted=counted
        )
        # A pixel weighs about as much as in a whole photo: gradient thresholds keep their meaning.
        loss_weight = None if mask is None else loss.loss.new_tensor(mask.loss_weight)
        if counted is not None:
            weights, share = counted_weights(weights, counted)
            loss_weight = share if loss_weight is None else loss_weight * share
        loss.loss.backward(loss_weight)  # type: ignore[no-untyped-call]
        visible = output.visible[0]
        if self._optimizer.backward_step is None:
            self._optimizer.step(visible)
        self._density.observe(visible, output.grad2d[0], output.max_weight)
        self._observe(loss.loss.detach(), image, target, weights)
        self.health.record_loss(self.step, index, loss.loss.detach())
        self.step += 1
        if self.step % min(CHECK_EVERY, config.densify_every) == 0:
            self.check()
        edit = self._density.edit(self._parameters, self.step)
        if edit is not None:
            self._apply(edit)
        self._average()

    def check(self) -> None:
        """Raise TrainingError if a loss, a gradient or a parameter is NaN or Inf."""
        self.health.check(self.step, self._parameters.tensors(), self._optimizer.skipped_rows)

    def _mask(self, index: int) -> RoiMask | None:
        """The mask of this step's photo; None: the step uses the whole photo."""
        masks = self.data.masks
        if masks is None or is_whole(self.step, self.config.full_every):
            return None
        return masks[index]

    def _render(self, index: int, mask: RoiMask | None, counted: Tensor | None) -> RenderOutput:
        p, camera = self._parameters, self.data.images[index].camera
        active = None if mask is None else mask.pixels
        if counted is not None:
            active = counted if active is None else active.to(counted.device) & counted
        greys = self.data.backgrounds
        return rasterize(
            p.means,
            p.quats,
            p.log_scales,
            p.logit_opacities,
            p.sh,
            self._viewmats[index : index + 1],
            self._intrinsics[index : index + 1],
            camera.width,
            camera.height,
            sh_degree=self.config.degree(self.step),
            raw=True,
            background=None if greys is None else greys[index].expand(3).to(p.means),
            with_max_weight=self._density.needs_max_weight,
            mask=active,
            backward_step=self._optimizer.backward_step,
        )

    def _observe(
        self, loss: Tensor, rendered: Tensor, target: Tensor, weights: Tensor | None
    ) -> None:
        """Update the running loss, and every `PSNR_EVERY` steps the PSNR, which costs more."""
        self._loss = torch.where(
            self._loss.isnan(), loss, RECENT * self._loss + (1 - RECENT) * loss
        )
        if self.step % PSNR_EVERY == 0:
            error = (rendered.detach() - target / 255.0).square().mean(dim=-1)
            if weights is None:
                mean = error.mean()
            else:
                mean = (error * weights).sum() / weights.sum().clamp(min=1)
            psnr = float(-10 * torch.log10(mean.clamp(min=1e-10)))
            self._psnr = psnr if self._psnr != self._psnr else 0.7 * self._psnr + 0.3 * psnr

    def _progress(self, stage: str, seconds_left: float) -> Progress:
        return Progress(
            stage=stage,
            step=self.step,
            total=self.config.steps,
            loss=float(self._loss),
            psnr=self._psnr,
            gaussians=len(self._parameters),
            seconds_left=seconds_left,
        )

    def _average(self) -> None:
        """Add the model to the mean; at the last step, the mean becomes the model."""
        config = self.config
        if self.step > config.steps - config.average_steps and self.step % AVERAGE_EVERY == 0:
            self._mean.add(self._parameters)
        if self.step == config.steps and self._mean.count:
            self._parameters = _leaves(self._mean.mean())
            self._mean.clear()

    def _prune_floaters(self, context: Context) -> bool:
        """Prune floaters; False if stopped, with nothing changed."""
        began, cpu_began = time.perf_counter(), time.process_time()
        data, views = self.data, self.config.min_views
        try:
            found = floaters(self._parameters, data.images, data.rois, data.points, views, context)
        except Stopped:
            return False
        if bool(found.any()):
            self._apply(unchanged(self._parameters).keep((~found).nonzero()[:, 0]))
        self.seconds += time.perf_counter() - began
        self.cpu_seconds += time.process_time() - cpu_began
        return True

    def _doing(self) -> str:
        """Describes the work for the message when memory is full."""
        width, height = self._largest()
        photos = f"photos of up to {width}x{height}"
        return f"step {self.step}, {len(self._parameters):,} Gaussians, {photos}"

    def _advice(self) -> str:
        return (
            "Close other programs that use the GPU, or train with smaller photos"
            f" (--max-side {smaller_side(*self._largest())}) or fewer Gaussians (a smaller"
            " --preset). The last checkpoint is kept."
        )

    def _largest(self) -> tuple[int, int]:
        cameras = [image.camera for image in self.data.images]
        return max(c.width for c in cameras), max(c.height for c in cameras)

    def _apply(self, edit: Edit) -> None:
        """Continue with the edited Gaussians and their optimizer state."""
        if edit.rows is not None:
            self._mean.clear()
            self._parameters = _leaves(edit.gaussians)
            self._optimizer.replace(self._parameters.tensors(), edit.rows)
            release_freed_memory()
        if edit.opacity_cap is not None:
            logit = float(np.log(edit.opacity_cap / (1 - edit.opacity_cap)))
            with torch.no_grad():
                self._parameters.logit_opacities.clamp_(max=logit)
            self._optimizer.zero_moments("logit_opacities")

    def _new_density(self, count: int) -> DensityControl:
        data = self.data
        inputs = DensityInputs(
            config=self.config,
            extent=data.extent,
            rois=data.rois,
            budgets=data.budgets,
            photos=len(data.images),
            seed=data.seed,
            device=data.device,
        )
        return density_control(inputs, count)

    def _new_optimizer(self) -> VisibleAdam:
        config, tensors = self.config, self._parameters.tensors()
        bands = tensors["sh"].shape[1]
        sh_learning_rates = torch.full((bands, 3), config.lr_shN)
        sh_learning_rates[0] = config.lr_sh0
        learning_rates: dict[str, float | Tensor] = {
            "means": config.lr_means * self.data.extent,
            "quats": config.lr_quats,
            "log_scales": config.lr_scales,
            "logit_opacities": config.lr_opacities,
            "sh": sh_learning_rates.flatten(),
        }
        parameters = {name: (tensors[name], learning_rates[name]) for name in NAMES}
        return VisibleAdam(parameters, fused=True)

    def state_dict(self) -> dict[str, Any]:
        """The complete training state: tensors on the CPU and plain numbers."""
        state = {
            "step": self.step,
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
            "loss": float(self._loss),
            "psnr": self._psnr,
            "parameters": {n: t.detach() for n, t in self._parameters.tensors().items()},
            "optimizer": self._optimizer.state_dict(),
            "mean": self._mean.state_dict(),
            "density": self._density.state_dict(),
        }
        return dict(on_device(state, CPU))

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a `state_dict`, which may come from another device."""
        state = on_device(state, self.data.device)
        self.step, self.seconds = int(state["step"]), float(state["seconds"])
        self.cpu_seconds = float(state["cpu_seconds"])
        self._loss, self._psnr = self._loss.new_tensor(state["loss"]), float(state["psnr"])
        self._parameters = _leaves(Gaussians(**state["parameters"]))
        self._optimizer = self._new_optimizer()
        self._optimizer.load_state_dict(state["optimizer"])
        self._mean.load_state_dict(state["mean"])
        self._density = self._new_density(len(self._parameters))
        self._density.load_state_dict(state["density"])


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Limit torch to one thread: its threads and the kernels' would compete for the same cores.

    torch's share of a training step is small; more threads would cost more than they gain.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _cameras(images: Sequence[PosedImage], device: torch.device) -> tuple[Tensor, Tensor]:
    """(V, 4, 4) world_to_camera and (V, 3, 3) intrinsics of the photos, float32 on the device."""
    poses = np.stack([image.world_to_camera for image in images])
    matrices = np.stack([image.camera.matrix() for image in images])
    return (
        torch.from_numpy(poses.astype(np.float32)).to(device),
        torch.from_numpy(matrices.astype(np.float32)).to(device),
    )


def _leaves(gaussians: Gaussians) -> Gaussians:
    """The same values as contiguous leaf tensors that require gradients."""
    return Gaussians(
        **{n: t.detach().contiguous().requires_grad_() for n, t in gaussians.tensors().items()}
    )
