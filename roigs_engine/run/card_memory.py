"""Estimates the GPU memory of a run before it starts.

The constants are what a training's tensors take, counted on the make-believe GPU of the tests
(tests/engine/run/test_card_memory.py compares). How much more torch's cache takes is an assumption.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..cuda.device import SHARE_OF_PHOTOS
from ..errors import SceneError
from ..formats.events import Message
from ..formats.text import in_gb
from ..model.scene import PosedImage
from ..rasterize.inputs import TILE

PER_GAUSSIAN = 850  # bytes: parameters and moments, statistics, what a step computes of it
PER_GAUSSIAN_EDITED = 1600  # .. and the copies while densifying, without a step's
PER_PIXEL = 110  # of the largest photo: pictures, gradients, the checkpoints of half-filled groups
PER_PAIR = 180  # of a Gaussian and a tile: its place in lists, its moments, the checkpoints
PAIRS = 200  # in a tile: see run/memory.py
BUFFER = 1.25  # cuda.pair_buffers: for more pairs than there are
CACHE = 1.2  # torch keeps freed blocks of other sizes
PER_PIXEL_AT_MOST = PER_PIXEL + int(PER_PAIR * PAIRS * BUFFER) // TILE**2
AHEAD = 3  # photos on the GPU at least: the one in use, and two that are sent ahead


@dataclass(frozen=True, kw_only=True)
class CardPlan:
    """The expected GPU memory of a run, in bytes.

    Attributes:
        free, total: of the GPU, before the training.
        photos: the photos that are kept there, at most.
        training: all but photos, on the largest photo, if the model grows to `count` Gaussians.
        count: that number (not bytes).
    """

    free: int
    total: int
    photos: int
    training: int
    count: int

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


def plan_card(
    images: Sequence[PosedImage], points: int, count: int, card: tuple[int, int]
) -> CardPlan:
    """The GPU memory that training on these photos needs.

    Args:
        images: all photos of the run.
        points: number of sparse points, which become the first Gaussians.
        count: the largest number of Gaussians that is expected.
        card: free and total bytes of the GPU.

    Raises:
        SceneError: the start of training does not fit; the hint says what would.
    """
    free, total = card
    pixels = max(i.camera.width * i.camera.height for i in images)
    ahead = AHEAD * max(image.decoded_bytes for image in images)
    model = int(CACHE * PER_GAUSSIAN * points)
    if model + CACHE * PER_PIXEL * pixels + ahead > free:
        need = model + int(CACHE * PER_PIXEL * pixels) + ahead
        raise SceneError(
            f"Training needs at least {in_gb(need)} of GPU memory ({points:,} points, photos of up"
            f" to {pixels / 1e6:.1f} megapixels); {in_gb(free)} of {in_gb(total)} are free.",
            _advice(images, free - model),
        )
    step = CACHE * (PER_GAUSSIAN * count + PER_PIXEL_AT_MOST * pixels) + ahead
    training = int(max(step, CACHE * PER_GAUSSIAN_EDITED * count))
    most = min(free // SHARE_OF_PHOTOS, max(free - training, 0))
    photos = min(sum(image.decoded_bytes for image in images), most)
    return CardPlan(free=free, total=total, photos=photos, training=training, count=count)


def _advice(images: Sequence[PosedImage], left: int) -> str:
    """A hint with the size of photos that fits beside the points."""
    otherwise = "lose other programs that use the GPU, or train on the CPU (--device cpu)."
    pixels = left / (3 * AHEAD + CACHE * PER_PIXEL)
    if pixels < 1:
        return f"C{otherwise}"
    largest = max((i.camera for i in images), key=lambda c: c.width * c.height)
    shrink = (pixels / (largest.width * largest.height)) ** 0.5
    side = max(1, int(shrink * max(largest.width, largest.height)))
    return f"Use --max-side {side} or less, c{otherwise}"
