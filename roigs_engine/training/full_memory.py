"""What a stage says when the GPU memory is full."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

from ..cuda.device import explain_out_of_memory, smaller_side
from ..model.scene import PosedImage


def explained(
    images: Sequence[PosedImage], now: Callable[[], tuple[int, int]]
) -> AbstractContextManager[None]:
    """Turn torch's error into one line.

    Args:
        images: of the stage.
        now: where it is: the step, and the number of Gaussians.

    Raises:
        GpuMemoryError: the GPU memory is full.
    """
    cameras = [image.camera for image in images]
    width, height = max(c.width for c in cameras), max(c.height for c in cameras)

    def doing() -> str:
        step, gaussians = now()
        return f"step {step}, {gaussians:,} Gaussians, photos of up to {width}x{height}"

    def advice() -> str:
        return (
            "Close other programs that use the GPU, or train with smaller photos"
            f" (--max-side {smaller_side(width, height)}) or fewer Gaussians (a smaller"
            " --preset). --device cpu resumes from the last checkpoint."
        )

    return explain_out_of_memory(doing, advice)
