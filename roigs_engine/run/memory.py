"""What a run will need of the machine's memory, said before it begins.

The constants were measured with `python -m benchmarks.memory` (docs/reliability.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..context import QUIET, Context
from ..errors import SceneError
from ..formats.events import Message
from ..machine import machine_memory
from ..model.scene import PosedImage
from ..training.config import TrainConfig
from .config import RunConfig
from .definition import Run

ENGINE = 260 << 20  # bytes of Python, torch and the kernels
PER_GAUSSIAN = 2800  # bytes: parameters, gradients, moments, and the copies while densifying
PER_PIXEL = 80  # bytes: the picture, its gradient and the loss's images, of the largest photo
PER_DENSIFICATION = 30_000  # the most Gaussians that one added, on average, on four scenes
AHEAD = 3  # photos held at least: the one in use, and two that are decoded ahead
DEFAULT_SHARE = 4  # the cache takes at most one part in so many of the machine's memory


@dataclass(frozen=True, kw_only=True)
class MemoryPlan:
    """Bytes.

    Attributes:
        machine: what there is.
        photos: all photos of the run, decoded.
        cache: what is kept of them at a time, at most.
        picture: what drawing the largest photo takes.
        start, end: the Gaussians at first, and as many as they may become.
        count: how many those are.
    """

    machine: int
    photos: int
    cache: int
    picture: int
    start: int
    end: int
    count: int

    @property
    def total(self) -> int:
        """The most that is expected."""
        return ENGINE + min(self.photos, self.cache) + self.picture + self.end

    def messages(self) -> list[Message]:
        """What people should know before the run begins."""
        kept = min(self.photos, self.cache)
        text = (
            f"Memory: up to about {_gb(self.total)} of {_gb(self.machine)}: photos {_gb(kept)},"
            f" {self.count:,} Gaussians {_gb(self.end)}, the rest {_gb(ENGINE + self.picture)}."
        )
        found = [Message(text=text)]
        if kept < self.photos:
            text = (
                f"The photos take {_gb(self.photos)} decoded; {_gb(kept)} are kept, the others"
                " decoded whenever they are needed (--image-cache, --max-side)."
            )
            found.append(Message(text=text))
        if self.total > self.machine:
            text = (
                "Should the Gaussians become so many, memory will not do. Use a smaller"
                " --max-side or --steps-factor if training ends for want of it."
            )
            found.append(Message(text=text, level="warning"))
        return found


def run_memory(run: Run, context: Context = QUIET) -> MemoryPlan:
    """`plan_memory` of a run."""
    return plan_memory(run.scene.images, len(run.scene.points), run.config, context.photo_memory)


def plan_memory(
    images: Sequence[PosedImage], points: int, config: RunConfig, cache: int | None = None
) -> MemoryPlan:
    """What training on these photos will need.

    Args:
        images: all photos of the run.
        points: sparse points, which become the first Gaussians.
        config: of the run.
        cache: bytes of photos to keep; None: a quarter of the memory, or what is left of it.

    Raises:
        SceneError: it cannot fit, whatever becomes of the Gaussians; says what size of photos does.
    """
    machine = machine_memory()
    largest = max(i.camera.width * i.camera.height for i in images)
    photos = sum(3 * i.camera.width * i.camera.height for i in images)
    count = points + PER_DENSIFICATION * (
        _densifications(config.scene) + _densifications(config.roi)
    )
    start = PER_GAUSSIAN * points
    least = 3 * AHEAD * largest
    left = machine - ENGINE - start
    if least + PER_PIXEL * largest > left:
        raise SceneError(
            f"Training needs {_gb(machine - left + least + PER_PIXEL * largest)} of memory at least"
            f" ({points:,} points, photos of up to {largest / 1e6:.1f} megapixels); there are"
            f" {_gb(machine)}.",
            _advice(images, left),
        )
    if cache is None:
        cache = min(machine // DEFAULT_SHARE, left - PER_PIXEL * largest)
    return MemoryPlan(
        machine=machine,
        photos=photos,
        cache=max(cache, least),
        picture=PER_PIXEL * largest,
        start=start,
        end=PER_GAUSSIAN * count,
        count=count,
    )


def _densifications(config: TrainConfig) -> int:
    until = min(config.densify_until, config.steps)
    return max(0, (until - config.densify_from) // config.densify_every)


def _advice(images: Sequence[PosedImage], left: int) -> str:
    """The size of photos that fits."""
    pixels = left / (3 * AHEAD + PER_PIXEL)
    if pixels < 1:
        return "Use a machine with more memory, or a model with fewer points."
    largest = max((i.camera for i in images), key=lambda c: c.width * c.height)
    shrink = (pixels / (largest.width * largest.height)) ** 0.5
    return f"Use --max-side {max(1, int(shrink * max(largest.width, largest.height)))} or less."


def _gb(size: int) -> str:
    return f"{size / 1e9:.1f} GB"
