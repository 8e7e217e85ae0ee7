"""One training stage: photos in, better Gaussians out; stops and goes on bit for bit."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..cuda.device import CPU, on_device
from ..cuda.memory import memory_explained, smaller
from ..cuda.photos import Photos, photos_on
from ..errors import Stopped
from ..formats.events import Emit, Progress, check_of, ignore
from ..machine import give_back_freed
from ..model.gaussians import NAMES, Gaussians
from ..model.roi import OrientedBox
from ..model.scene import PosedImage
from ..rasterize import rasterize
from . import densify, photo_order
from .averaging import ModelMean
from .budget import BoxCapacity
from .callbacks import Break
from .config import TrainConfig
from .consistency import vouched_for
from .densify import DensityStats, Edit
from .health import CHECK_EVERY, Health
from .losses import photo_loss
from .masks import Region, Regions
from .optimizer import VisibleAdam
from .photo_order import PhotoAt

REPORT_SECONDS = 0.5
RESET_OPACITY = 0.01
AVERAGE_EVERY = 10  # steps between the models that are averaged: neighbours hardly differ
PSNR_EVERY = 50  # steps
RECENT = 0.98  # weight of the past in the running loss and PSNR that progress shows


@dataclass(frozen=True, kw_only=True, eq=False)
class StageData:
    """What a stage trains on.

    Attributes:
        images: posed photos; `photo_at` gives rows of it.
        photos: their pixels, by the same rows.
        photo_at: the photo of each step.
        extent: the *scene's* extent, for position rates and world-size pruning.
        rois: boxes that confine densification, when the stage's config says so.
        capacities: of each box; None: no limit.
        regions: what steps look at that do not look at whole photos (`config.full_every`).
        seed: of the split positions.
        device: where to train; the result is the same but for rounding.
    """

    images: Sequence[PosedImage]
    photos: Photos
    photo_at: PhotoAt
    extent: float
    rois: Sequence[OrientedBox] = ()
    capacities: Sequence[BoxCapacity] | None = None
    regions: Regions | None = None
    seed: int = 0
    device: torch.device = CPU


class Trainer:
    """Optimises Gaussians on posed photos (Kerbl et al. 2023, with the paper's sec. II-B changes).

    Everything random is a function of (seed, step), so `state_dict` holds no generator, and a
    trainer loaded from it continues as if it had never stopped.

    A step reads no number back from its device: what progress shows stays there until it is shown.
    """

    def __init__(self, gaussians: Gaussians, data: StageData, config: TrainConfig) -> None:
        """Begin at step 0 with a copy of `gaussians`."""
        self.config = config
        self.data = data
        self.step = 0
        self.seconds = 0.0
        gaussians = gaussians.to(data.device)
        self.cpu_seconds = 0.0  # of the whole process, all its threads
        order = densify.morton_order(gaussians.means)
        self._parameters = _leaves(gaussians.rows(order))
        self._optimizer = self._new_optimizer()
        self._stats = DensityStats.zeros(len(order), data.device)
        self._mean = ModelMean()
        self._window = 0
        self.health = Health([image.name for image in data.images])
        self._photos = photos_on(data.device, data.photos)
        self._viewmats, self._intrinsics = _cameras(data.images, data.device)
        self._last_loss = self._loss = torch.tensor(torch.nan, device=data.device)
        self._psnr = float("nan")

    @property
    def gaussians(self) -> Gaussians:
        """The present model; its tensors are the trainer's own."""
        return self._parameters

    @property
    def last_loss(self) -> float:
        """The loss of the last step; NaN before the first."""
        return float(self._last_loss)

    def run(
        self,
        *,
        stage: str = "",
        emit: Emit = ignore,
        should_stop: Callable[[], bool] = lambda: False,
        on_pause: Callable[[], None] = lambda: None,
        pause_seconds: float = 60.0,
        on_preview: Callable[[], None] = lambda: None,
        preview_seconds: float = 0.0,
    ) -> bool:
        """Train until the config's last step, then leave floaters out; False when stopped before.

        Args:
            stage: name that progress events carry.
            emit: takes progress events, at most two a second.
            should_stop: asked before every step, and between the photos that show floaters.
            on_pause: called every `pause_seconds` of training, to write a checkpoint.
            pause_seconds: see above.
            on_preview, preview_seconds: the same, to show the present model; 0: never.
        """
        breaks = [Break(pause_seconds, on_pause), Break(preview_seconds, on_preview)]
        with one_torch_thread(), memory_explained(self._doing, self._advice):
            return self._run(stage, emit, should_stop, breaks)

    def _run(
        self,
        stage: str,
        emit: Emit,
        should_stop: Callable[[], bool],
        breaks: Sequence[Break],
    ) -> bool:
        started = reported = time.perf_counter()
        before, first = self.seconds, self.step
        cpu_started = time.process_time() - self.cpu_seconds
        while self.step < self.config.steps:
            if should_stop():
                break
            self.train_step()
            now = time.perf_counter()
            self.seconds = before + now - started
            self.cpu_seconds = time.process_time() - cpu_started
            if now - reported > REPORT_SECONDS or self.step == self.config.steps:
                reported = now
                left = (now - started) / (self.step - first) * (self.config.steps - self.step)
                emit(self._progress(stage, left))
            for one in breaks:
                # Writing files is not training: the clock leaves it out.
                started += one.take_if_due(self.seconds)
            cpu_started = time.process_time() - self.cpu_seconds
        if self.step < self.config.steps:
            return False
        return not self.config.front_photos or self._leave_floaters_out(should_stop)

    def train_step(self) -> None:
        """One photo: render, compare, descend; then edit the Gaussians where that is due."""
        config, data = self.config, self.data
        index = data.photo_at(self.step)
        self._photos.prefetch([data.photo_at(self.step + ahead) for ahead in (1, 2)])
        target = self._photos[index]
        self._optimizer.set_lr("means", config.position_rate(self.step) * data.extent)
        region = self._region(index)
        output = self._render(index, region)
        # squeeze, not [0]: its gradient is a view, that of an index is a copy into zeros
        image, weights = output.image.squeeze(0), None
        if region is not None:
            image, target = region.crop(image), region.crop(target)
            weights = region.weights
        loss = photo_loss(image, target, ssim_weight=config.ssim_weight, weights=weights)
        # A pixel pulls about as hard as in a whole photo: thresholds keep their meaning.
        pull = None if region is None else loss.loss.new_tensor(region.pull)
        loss.loss.backward(pull)  # type: ignore[no-untyped-call]
        visible = output.visible[0]
        if not self._optimizer.fused:
            self._optimizer.step(visible)
        self._stats.add(visible, output.grad2d[0], output.max_weight)
        self._observe(loss.loss.detach(), image, target, weights)
        self.health.saw(self.step, index, loss.loss.detach())
        self.step += 1
        if self.step % min(CHECK_EVERY, config.densify_every) == 0:
            self.check()
        self._edit()
        self._average()

    def check(self) -> None:
        """Look whether all is well so far. Raises TrainingError where numbers are none."""
        self.health.check(self.step, self._parameters.tensors(), self._optimizer.skipped_rows)

    def _region(self, index: int) -> Region | None:
        """What this step looks at of the photo; None: all of it."""
        regions = self.data.regions
        if regions is None or photo_order.is_whole(self.step, self.config.full_every):
            return None
        return regions[index]

    def _render(self, index: int, region: Region | None) -> Any:
        p, camera = self._parameters, self.data.images[index].camera
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
            with_max_weight=self.config.contribution_every > 0,
            region=None if region is None else region.mask,
            optimizer=self._optimizer if self._optimizer.fused else None,
        )

    def _observe(
        self, loss: Tensor, rendered: Tensor, target: Tensor, weights: Tensor | None
    ) -> None:
        """Keep the running loss; the PSNR costs a pass over the image, so only now and then."""
        self._last_loss = loss
        self._loss = torch.where(
            self._loss.isnan(), loss, RECENT * self._loss + (1 - RECENT) * loss
        )
        if self.step % PSNR_EVERY == 0:
            error = (rendered.detach() - target / 255.0).square().mean(dim=-1)
            mean = error.mean() if weights is None else (error * weights).sum() / weights.sum()
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

    def _edit(self) -> None:
        """Densify, prune, reset: whatever is due after `self.step` steps."""
        config, step = self.config, self.step
        densifying = config.densify_from <= step < config.densify_until
        if densifying and step % config.densify_every == 0:
            self._apply(self._densified())
        if config.contribution_every and step - self._window >= self._window_steps():
            contributing = self._stats.weight >= densify.VISIBLE_WEIGHT
            self._keep(contributing)
            self._stats.new_window()
            self._window = step
        if densifying and config.reset_every and step % config.reset_every == 0:
            self._reset_opacities()

    def _average(self) -> None:
        """Take the model into the mean, and end with that."""
        config = self.config
        if self.step > config.steps - config.average_steps and self.step % AVERAGE_EVERY == 0:
            self._mean.add(self._parameters)
        if self.step == config.steps and self._mean.count:
            self._parameters = _leaves(self._mean.mean())
            self._mean.clear()

    def _leave_floaters_out(self, should_stop: Callable[[], bool]) -> bool:
        """End with what the photos vouch for; False when stopped before, with nothing changed."""
        began, cpu_began = time.perf_counter(), time.process_time()
        data, photos = self.data, self.config.front_photos
        check = check_of(should_stop)
        try:
            keep = vouched_for(self._parameters, data.images, data.rois, photos, check)
        except Stopped:
            return False
        self._keep(keep)
        self.seconds += time.perf_counter() - began
        self.cpu_seconds += time.process_time() - cpu_began
        return True

    def _doing(self) -> str:
        """For the message when memory is full."""
        width, height = self._largest()
        photos = f"photos of up to {width}x{height}"
        return f"step {self.step}, {len(self._parameters):,} Gaussians, {photos}"

    def _advice(self) -> str:
        return (
            "Close what else uses the card, or train with smaller photos"
            f" (--max-side {smaller(*self._largest())}) or fewer Gaussians (a smaller --preset)."
            " The last checkpoint is untouched."
        )

    def _largest(self) -> tuple[int, int]:
        cameras = [image.camera for image in self.data.images]
        return max(c.width for c in cameras), max(c.height for c in cameras)

    def _window_steps(self) -> int:
        """A window must hold every photo: «non-contributing» means on all of them."""
        return max(self.config.contribution_every, 2 * len(self.data.images))

    def _densified(self) -> Edit:
        config, data = self.config, self.data
        rng = torch.Generator().manual_seed(data.seed * 1_000_003 + self.step)
        now = self._parameters
        progress = self.step / config.densify_until
        capacities = data.capacities
        limits = None if capacities is None else [c.at(progress) for c in capacities]
        chosen = densify.choose(now, self._stats, config, data.rois, limits)
        reference = densify.size_reference(now, config, data.rois, data.extent)
        edit = densify.grow(now, chosen, reference, config.split_fraction, rng)
        keep = densify.worth_keeping(edit.gaussians, config, data.extent, self.step)
        rows = keep.nonzero()[:, 0]
        order = densify.morton_order(edit.gaussians.means[rows])
        return densify.keep_rows(edit, rows[order])

    def _apply(self, edit: Edit) -> None:
        """Go on with the edited Gaussians; optimiser state and statistics follow."""
        self._mean.clear()
        self._parameters = _leaves(edit.gaussians)
        self._optimizer.replace(self._parameters.tensors(), edit.rows)
        self._stats = self._stats.after(edit.rows)
        give_back_freed()

    def _keep(self, rows: Tensor) -> None:
        """Go on with the Gaussians whose place in `rows`, (N,) bool, is true."""
        if not bool(rows.all()):
            self._apply(densify.keep_rows(densify.unchanged(self._parameters), rows))

    def _reset_opacities(self) -> None:
        logit = float(np.log(RESET_OPACITY / (1 - RESET_OPACITY)))
        with torch.no_grad():
            self._parameters.logit_opacities.clamp_(max=logit)
        self._optimizer.zero_moments("logit_opacities")

    def _new_optimizer(self) -> VisibleAdam:
        config, tensors = self.config, self._parameters.tensors()
        bands = tensors["sh"].shape[1]
        sh_rates = torch.full((bands, 3), config.lr_shN)
        sh_rates[0] = config.lr_sh0
        rates: dict[str, float | Tensor] = {
            "means": config.lr_means * self.data.extent,
            "quats": config.lr_quats,
            "log_scales": config.lr_scales,
            "logit_opacities": config.lr_opacities,
            "sh": sh_rates.flatten(),
        }
        parameters = {name: (tensors[name], rates[name]) for name in NAMES}
        return VisibleAdam(parameters, fused=True)

    def state_dict(self) -> dict[str, Any]:
        """Everything that decides how training goes on; tensors on the CPU and plain numbers."""
        stats = self._stats
        state = {
            "step": self.step,
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
            "window": self._window,
            "loss": float(self._loss),
            "psnr": self._psnr,
            "parameters": {n: t.detach() for n, t in self._parameters.tensors().items()},
            "optimizer": self._optimizer.state_dict(),
            "mean": self._mean.state_dict(),
            "stats": {"gradient": stats.gradient, "views": stats.views, "weight": stats.weight},
        }
        return dict(on_device(state, CPU))

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what `state_dict` returned, on whatever device."""
        state = on_device(state, self.data.device)
        self.step, self.seconds = int(state["step"]), float(state["seconds"])
        self.cpu_seconds = float(state["cpu_seconds"])
        self._window = int(state["window"])
        self._loss, self._psnr = self._loss.new_tensor(state["loss"]), float(state["psnr"])
        self._parameters = _leaves(Gaussians(**state["parameters"]))
        self._optimizer = self._new_optimizer()
        self._optimizer.load_state_dict(state["optimizer"])
        self._mean.load_state_dict(state["mean"])
        self._stats = DensityStats(**state["stats"])


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Keep torch's own pool quiet: it and the kernels' pool would fight for the same cores.

    What torch does in a training step is small; its threads cost more than they bring.
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
    """The same values as contiguous leaf tensors that collect gradients."""
    return Gaussians(
        **{n: t.detach().contiguous().requires_grad_() for n, t in gaussians.tensors().items()}
    )
