"""Parallel undistortion of a scene's photos into a cache, without unused files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from ..context import QUIET, Context
from ..errors import SceneError
from ..formats.files import cannot_write, own_folder
from ..formats.run_files import UNDISTORTED
from ..formats.text import in_gb
from ..machine import ENGINE, disk_message, machine_memory, release_freed_memory
from ..model.scene import PosedImage
from ..photos.headers import PhotoError
from ..photos.parallel import in_parallel, threads_for
from .undistort import UndistortionPlan, temporary_folder, undistort

STAGE = "undistort"
PER_PIXEL = 3  # bytes of a PNG, at most; photos take about 2


def undistort_all(
    plans: Iterable[UndistortionPlan], cache: Path | None, context: Context = QUIET
) -> dict[str, Path]:
    """The undistorted photos by their plans' keys; the damaged ones are left out.

    `cache`: its folder `undistorted` keeps them; None: a temporary folder.

    Raises:
        SceneError: the machine has too little memory for one of them.
        RunFolderError: the cache cannot be written.
    """
    folder = temporary_folder() if cache is None else own_folder(cache, UNDISTORTED)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise cannot_write(folder, error) from error
    by_key = {plan.key(): plan for plan in plans}
    paths = {key: folder / f"{key}.png" for key in by_key}
    missing = [plan for key, plan in by_key.items() if not paths[key].is_file()]
    if not missing:
        return paths
    memory = _memory(missing, context)
    space = disk_message(
        PER_PIXEL * sum(plan.target.width * plan.target.height for plan in missing), folder
    )
    if space.level == "warning":
        context.emit(space)

    def make(plan: UndistortionPlan) -> None:
        undistort(plan, paths[plan.key()])

    with in_parallel(make, missing, memory, context, STAGE) as work:
        for plan, job in work:
            try:
                job.result()
            except PhotoError as error:
                context.warn(error.message)
                del paths[plan.key()]
    release_freed_memory()
    return paths


def missing_in(cache: Path, images: Iterable[PosedImage]) -> list[PosedImage]:
    """The photos that are not undistorted yet; `cache` may lack them all, or not exist."""
    return [
        image
        for image in images
        if image.distorted and not (cache / UNDISTORTED / f"{image.digest}.png").is_file()
    ]


def remove_unused(cache: Path, images: Iterable[PosedImage]) -> None:
    """Delete the undistorted photos in `cache` that `images` do not use."""
    used = {image.path.name for image in images}
    for path in own_folder(cache, UNDISTORTED).glob("*.png"):
        if path.name not in used:
            with suppress(OSError):
                path.unlink()


def _memory(plans: Sequence[UndistortionPlan], context: Context) -> int:
    """Bytes that the largest photo needs; tells the user what all threads take."""
    largest = max(plans, key=UndistortionPlan.memory)
    needed, machine = largest.memory(), machine_memory()
    if needed + ENGINE > machine:
        pixels = largest.size[0] * largest.size[1]
        side = largest.fitting_side(machine - ENGINE)
        raise SceneError(
            f"Undistorting a photo of {pixels / 1e6:.1f} megapixels needs"
            f" {in_gb(needed + ENGINE)} of memory; this machine has {in_gb(machine)}.",
            f"Use --max-side {side} or less." if side else "Use smaller photos (--images).",
        )
    threads = min(threads_for(needed), len(plans))
    context.info(
        f"Memory: up to about {in_gb(threads * needed + ENGINE)} of {in_gb(machine)} while photos"
        f" are undistorted, {threads} at a time."
    )
    return needed
