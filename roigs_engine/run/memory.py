"""Estimates a run's memory, on the machine and on a GPU, before it starts.

The machine's constants were measured with `python -m benchmarks.memory` (docs/reliability.md). The
GPU's constants are the sizes of training's tensors, counted on the simulated GPU of the tests
(tests/engine/run/test_card_memory.py compares them). The extra memory of torch's cache is an
assumption.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from ..context import QUIET, Context
from ..cuda.device import SHARE_OF_PHOTOS, card_memory
from ..errors import SceneError
from ..formats.events import Message
from ..formats.text import in_gb
from ..gpu.program import opened
from ..machine import ENGINE, machine_memory
from ..model.scene import PosedImage, SfmScene
from ..rasterize.inputs import TILE
from ..training.config import TrainConfig
from ..training.mechanisms.density_control import DensityControl
from .config import RunConfig
from .layout import Layout
from .plan import Stage

PER_JOINED = 1450  # bytes per Gaussian to join and write models (measured: four of 400,000)
PER_GAUSSIAN = 2800  # bytes: parameters, gradients, moments, and copies during densification
PER_PIXEL = 80  # bytes at least, for the largest photo: render, gradient, the loss's images
PER_PAIR = 100  # bytes: a Gaussian's entry in a tile's list, its gradient there (kernels/view.h)
PAIRS = 200  # pairs in a tile, if Gaussians are larger than tiles; real scenes had up to 190
PER_PIXEL_AT_MOST = 120 + PER_PAIR * PAIRS // TILE**2
PER_DENSIFICATION = 30_000  # Gaussians that one adds on average, in the scene with most (of four)
AHEAD = 3  # photos in memory at least: the one in use, and two decoded ahead
DEFAULT_SHARE = 4  # the cache takes at most 1/4 of the machine's memory
CARD_PER_GAUSSIAN = 850  # bytes: parameters and moments, statistics, results of a step
CARD_PER_GAUSSIAN_EDITED = 1600  # bytes during densification: with copies, without a step's results
CARD_PER_PIXEL = 110  # for the largest photo: pictures, gradients, half-filled groups' checkpoints
CARD_PER_PAIR = 180  # for a Gaussian in a tile: its place in lists, its moments, the checkpoints
CARD_BUFFER = 1.25  # cuda.pair_buffers allocates more than the number of pairs
CARD_CACHE = 1.2  # torch also keeps freed blocks of other sizes
CARD_PER_PIXEL_AT_MOST = CARD_PER_PIXEL + int(CARD_PER_PAIR * PAIRS * CARD_BUFFER) // TILE**2
CARD_AHEAD = 3  # photos on the GPU at least: the one in use, and two sent ahead


@dataclass(frozen=True, kw_only=True)
class CardPlan:
    """The expected GPU memory of a run, in bytes."""

    free: int  # free memory of the GPU before the training
    total: int  # the GPU's memory
    photos: int  # limit for photos kept on the GPU
    training: int  # everything except photos, for the largest photo and `count` Gaussians
    count: int  # the largest number of Gaussians expected (not bytes)

    def messages(self) -> list[Message]:
        """Messages for the user before the run starts."""
        text = (
            f"GPU memory: up to about {in_gb(self.training + self.photos)} of"
            f" {in_gb(self.free)} free ({in_gb(self.total)} in all): photos {in_gb(self.photos)},"
            f" {in_gb(self.training)} if a model grows to {self.count:,} Gaussians."
        )
        found = [Message(text=text)]
        if self.training + self.photos > self.free:
            text = (
                f"GPU memory will run out if the model grows to {self.count:,} Gaussians. Use a"
                " smaller --max-side or --steps-factor, or --device cpu, if that happens."
            )
            found.append(Message(text=text, level="warning"))
        return found


@dataclass(frozen=True, kw_only=True)
class MemoryPlan:
    """The expected memory of a run, in bytes."""

    machine: int  # memory of the machine
    photos: int  # all photos of the run, decoded
    cache: int  # limit for decoded photos kept at a time
    picture: int  # for training on the largest photo
    end: int  # for the largest number of Gaussians expected
    count: int  # that number (not bytes)
    joined: int = 0  # for joining and drawing the models of blocks; 0: there are no blocks
    blocks: int = 1  # number of blocks; the other numbers are for the largest one
    card: CardPlan | None = None  # for the GPU that trains; None: the CPU trains
    gpu_holds: int | None = None  # Gaussians that buffers of `gpu.program`'s GPU hold; None: no GPU

    @property
    def total(self) -> int:
        """The expected peak memory."""
        training = min(self.photos, self.cache) + self.end
        return ENGINE + self.picture + max(training, self.joined)

    @property
    def joining(self) -> int:
        """The expected peak memory after all stages are trained."""
        return ENGINE + self.picture + self.joined if self.joined else self.total

    def messages(self) -> list[Message]:
        """Messages for the user before the run starts."""
        kept = min(self.photos, self.cache)
        each = f" in each of {self.blocks} blocks" if self.blocks > 1 else ""
        text = (
            f"Memory: up to about {in_gb(self.total)} of {in_gb(self.machine)}{each}: photos"
            f" {in_gb(kept)}, {in_gb(self.end)} if a model grows to {self.count:,} Gaussians,"
            f" the rest {in_gb(ENGINE + self.picture)}."
        )
        found = [Message(text=text)]
        if self.joined:
            found.append(Message(text=f"Joining the blocks takes about {in_gb(self.joined)}."))
        if kept < self.photos:
            text = (
                f"The decoded photos take {in_gb(self.photos)}; {in_gb(kept)} are kept in memory"
                " and the others are decoded again for each use (--image-cache, --max-side)."
            )
            found.append(Message(text=text))
        if self.total > self.machine:
            text = (
                f"Memory will run out if the model grows to {self.count:,} Gaussians. Use --blocks,"
                " a smaller --max-side or --steps-factor if that happens."
            )
            found.append(Message(text=text, level="warning"))
        if self.gpu_holds is not None and self.count > self.gpu_holds:
            text = (
                f"The GPU's buffers hold {self.gpu_holds:,} Gaussians; if the model grows beyond"
                " that, the processor draws it."
            )
            found.append(Message(text=text, level="warning"))
        return [*found, *(self.card.messages() if self.card else ())]


def with_card(
    plan: MemoryPlan, scene: SfmScene, layout: Layout, context: Context = QUIET
) -> MemoryPlan:
    """Add the GPU's memory to a run's plan, if one is used: for the block with most photos."""
    device = torch.device(context.device)
    if device.type != "cuda":
        gpu = opened()
        return plan if gpu is None else replace(plan, gpu_holds=gpu.adapter.gaussians)
    images, points = scene.images, len(scene.points)
    if layout.blocks is not None:
        block = max(layout.blocks.cells, key=lambda cell: len(cell.photos))
        images, points = scene.select(block.photos).images, len(block.points)
    return replace(plan, card=plan_card(images, points, plan.count, card_memory(device)))


def layout_memory(
    scene: SfmScene, layout: Layout, config: RunConfig, cache: int | None = None
) -> MemoryPlan:
    """`plan_memory` of a run: for its scene, with test photos, or for the largest block."""
    whole = len(scene.points)
    if layout.blocks is None:
        return plan_memory(scene.images, whole, config, cache)
    plans = cell_memory(scene, layout, config, cache)
    count = whole + PER_DENSIFICATION * _densifications(config.scene, config.roi)
    largest = max(plans, key=lambda plan: plan.total)
    return replace(largest, joined=PER_JOINED * count, blocks=len(layout.blocks.cells))


def cell_memory(
    scene: SfmScene, layout: Layout, config: RunConfig, cache: int | None = None
) -> list[MemoryPlan]:
    """`plan_memory` for each cell of a scene: first the blocks, then the other cells."""
    splits = [split for split in (layout.blocks, layout.cells) if split]
    return [
        plan_memory(
            scene.select(cell.photos).images,
            len(cell.points),
            config,
            cache,
            share=len(cell.points) / max(len(scene.points), 1),
        )
        for split in splits
        for cell in split.cells
    ]


def stage_memory(
    stage: Stage, scene: SfmScene, config: RunConfig, whole: MemoryPlan, cache: int | None = None
) -> int:
    """The expected peak memory, bytes, of an engine that trains one stage of a run.

    `scene` has the training photos; `whole` is the memory of the run.
    """
    share = stage.start_share(len(scene.points))
    points = round(share * len(scene.points))
    try:
        own = plan_memory(stage.images, points, config, cache, share=share)
    except SceneError:  # too large for this machine, perhaps not for the one that trains
        return machine_memory()
    joins = stage.start.base is not None  # it starts from the joined models of all blocks
    return replace(own, joined=whole.joined if joins else 0).total


def plan_memory(
    images: Sequence[PosedImage],
    points: int,
    config: RunConfig,
    cache: int | None = None,
    *,
    share: float = 1.0,
) -> MemoryPlan:
    """Estimate the memory for training on these photos.

    Args:
        images, config: all photos of the run, and its settings.
        points: number of sparse points, which become the first Gaussians.
        cache: bytes of decoded photos to keep; None: a quarter of the memory, or less if less is
            free.
        share: of the scene that these photos show; its growth is multiplied by it.

    Raises:
        SceneError: the start of training does not fit; the hint gives a photo size that does.
    """
    machine = machine_memory()
    largest = max(i.camera.width * i.camera.height for i in images)
    photos = sum(image.decoded_bytes for image in images)
    growth = PER_DENSIFICATION * _densifications(config.scene, config.roi)
    count = points + round(share * growth)
    start = PER_GAUSSIAN * points
    least = AHEAD * max(image.decoded_bytes for image in images)
    left = machine - ENGINE - start
    if least + PER_PIXEL * largest > left:
        side = _largest_side(images, left / (3 * AHEAD + PER_PIXEL))
        raise SceneError(
            f"Training needs at least {in_gb(machine - left + least + PER_PIXEL * largest)} of"
            f" memory ({points:,} points, photos of up to {largest / 1e6:.1f} megapixels); this"
            f" machine has {in_gb(machine)}.",
            "Use a machine with more memory, or a model with fewer points."
            if side is None
            else f"Use --max-side {side} or less.",
        )
    if cache is None:
        cache = min(machine // DEFAULT_SHARE, left - PER_PIXEL_AT_MOST * largest)
    return MemoryPlan(
        machine=machine,
        photos=photos,
        cache=max(cache, least),
        picture=PER_PIXEL_AT_MOST * largest,
        end=PER_GAUSSIAN * count,
        count=count,
    )


def plan_card(
    images: Sequence[PosedImage], points: int, count: int, card: tuple[int, int]
) -> CardPlan:
    """Estimate the GPU memory for training; arguments as for `plan_memory`.

    Args:
        count: the largest number of Gaussians expected.
        card: free and total bytes of the GPU.

    Raises:
        SceneError: the start of training does not fit; the hint says what does.
    """
    free, total = card
    pixels = max(i.camera.width * i.camera.height for i in images)
    ahead = CARD_AHEAD * max(image.decoded_bytes for image in images)
    model = int(CARD_CACHE * CARD_PER_GAUSSIAN * points)
    if model + CARD_CACHE * CARD_PER_PIXEL * pixels + ahead > free:
        need = model + int(CARD_CACHE * CARD_PER_PIXEL * pixels) + ahead
        left = (free - model) / (3 * CARD_AHEAD + CARD_CACHE * CARD_PER_PIXEL)
        side = _largest_side(images, left)
        otherwise = "lose other programs that use the GPU, or train on the CPU (--device cpu)."
        raise SceneError(
            f"Training needs at least {in_gb(need)} of GPU memory ({points:,} points, photos of up"
            f" to {pixels / 1e6:.1f} megapixels); {in_gb(free)} of {in_gb(total)} are free.",
            f"C{otherwise}" if side is None else f"Use --max-side {side} or less, c{otherwise}",
        )
    step = CARD_CACHE * (CARD_PER_GAUSSIAN * count + CARD_PER_PIXEL_AT_MOST * pixels) + ahead
    training = int(max(step, CARD_CACHE * CARD_PER_GAUSSIAN_EDITED * count))
    most = min(free // SHARE_OF_PHOTOS, max(free - training, 0))
    photos = min(sum(image.decoded_bytes for image in images), most)
    return CardPlan(free=free, total=total, photos=photos, training=training, count=count)


def _densifications(*stages: TrainConfig) -> int:
    """Number of densifications of these stages."""
    return sum(
        max(0, (min(density.until, config.steps) - density.start) // density.every)
        for config in stages
        if (density := config.get(DensityControl))
    )


def _largest_side(images: Sequence[PosedImage], pixels: float) -> int | None:
    """The longer side of the largest photo when reduced to `pixels`; None: less than a pixel."""
    if pixels < 1:
        return None
    largest = max((i.camera for i in images), key=lambda c: c.width * c.height)
    shrink = (pixels / (largest.width * largest.height)) ** 0.5
    return max(1, int(shrink * max(largest.width, largest.height)))
