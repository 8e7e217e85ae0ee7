"""Loads scene, boxes, masks and device of a request."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from ..context import Context
from ..errors import ConfigError, RoiError
from ..formats import run_files
from ..formats.files import write_text
from ..formats.names import first_taken
from ..formats.projects import is_video, model_folders, project_folder
from ..formats.rois import refuse_many, rois_document
from ..formats.text import counted
from ..machine import return_large_blocks
from ..model.roi import AUTOMATIC_NAME, OrientedBox, automatic_box, load_rois, parse_roi
from ..model.scene import SfmScene
from ..photos.files import EXTENSIONS, HEIC, PhotoFolder
from ..photos.mask_paths import MaskOptions
from ..requests.groups import Boxes, Exposures, ObjectMasks, PhotoMasks, PhotoSize, Scene
from ..requests.values import AUTO

if TYPE_CHECKING:
    from ..model.gaussians import Gaussians
    from ..model.local_frame import LocalFrame


def use_threads(threads: int | None) -> None:
    """Set the threads of the CPU kernels, if a number is given."""
    if threads is not None:  # otherwise, do not load the kernels: they may not run here
        from ..kernels.library import set_threads

        set_threads(threads)


def import_torch(context: Context) -> None:
    """Import torch, which takes seconds; `Stopped` on request."""
    context.interruptible(lambda: import_module("torch"))


def on_device(context: Context, device: str) -> Context:
    """Return the context with a device, and prepare the process for it; KernelError without it."""
    import_torch(context)
    from ..cuda.device import choose_device
    from ..training.gpu_check import check_once

    return_large_blocks()
    return replace(context, device=str(choose_device(device, context, check_once)))


def load_model(path: Path, frame: LocalFrame, context: Context) -> Gaussians:
    """Load the Gaussians of a PLY in a frame, on the context's device; errors as in `read_ply`."""
    import torch

    from ..model.gaussians import Gaussians

    model = Gaussians.load_ply(path, frame, context.check_cancelled)
    return model.to(torch.device(context.device))


# --- scene ---


def load_scene(
    request: PhotoSize,
    context: Context,
    cache: Path | None = None,
    *,
    pixels: bool = True,
    contents: bool = False,
    check: Callable[[SfmScene], None] | None = None,
    masks: MaskOptions | None = None,
) -> SfmScene:
    """Load the scene of a request.

    Args:
        cache: folder for undistorted photos; None: only cameras are needed, not pixels.
        pixels: False if only cameras, and what `cache` knows of the photos, are needed.
        contents: whether photos get their digests and masks, without a `cache`, too.
        check: called with the cameras before any photo is decoded.
        masks: which to use; None for those of `mask_options`, without object masks.
    """
    from ..colmap.exposures import with_exposures
    from ..colmap.project import load_colmap
    from ..colmap.undistort import temporary_folder

    use_threads(request.threads)
    if contents and cache is None:
        cache, pixels = temporary_folder(), False
    scene = load_colmap(
        request.scene,  # type: ignore[attr-defined]  # each request with a scene has its own help
        images=request.images,
        cache=cache,
        downscale=request.downscale,
        max_side=request.max_side,
        masks=masks or mask_options(request),
        pixels=pixels and cache is not None,
        check=check,
        context=context,
    )
    if isinstance(request, Exposures) and not request.no_exposures and cache is not None:
        scene = with_exposures(scene, cache, pixels=pixels, context=context)
    return _without(scene, request.exclude, context) if isinstance(request, Scene) else scene


def _without(scene: SfmScene, photos: Sequence[str], context: Context) -> SfmScene:
    there = {image.name for image in scene.images}
    skipped = {name for names in scene.skipped.values() for name in names}
    unknown = [name for name in photos if name not in there | skipped]
    if unknown:
        raise ConfigError(
            f"There is no photo '{unknown[0]}' to exclude.", "Use its name in the COLMAP model."
        )
    excluded = tuple(sorted(there & set(photos)))
    if not excluded:
        return scene
    if len(excluded) == len(there):
        raise ConfigError("--exclude leaves no photo.", "Exclude fewer.")
    context.info(f"Excluded {counted(len(excluded), 'photo')}.")
    return replace(scene.without(excluded), skipped={**scene.skipped, "excluded": excluded})


def mask_options(
    request: object, boxes: Iterable[str] = (), run: Path | None = None
) -> MaskOptions:
    """Return a request's mask options; the defaults if it has none.

    Args:
        request: any request.
        boxes: names of the boxes whose object masks are used, unless the request refuses them.
        run: the run folder; its object masks are used, unless a folder of masks is given.

    Raises:
        ConfigError: `object_masks` names no folder.
    """
    given = request if isinstance(request, PhotoMasks) else PhotoMasks()
    own = request if isinstance(request, ObjectMasks) else ObjectMasks()
    objects = own.object_masks
    if objects is not None and not objects.is_dir():
        raise ConfigError(f"{objects} is not a folder.", "Give --object-masks the masks' folder.")
    if objects is None and given.masks is None and run is not None:
        objects = run / run_files.OBJECT_MASKS
    return MaskOptions(
        folder=given.masks,
        objects=objects,
        inverted=given.invert_masks,
        used=not given.no_masks,
        boxes=() if own.no_object_masks else tuple(boxes),
        other_boxes=isinstance(request, Boxes) and bool(request.only),
    )


def is_photos(scene: Path) -> bool:
    """Whether the scene is a folder of photos without a COLMAP model, or a video."""
    if is_video(scene):
        return True
    if not scene.is_dir() or model_folders(project_folder(scene)):
        return False
    return count_photos(scene) > 0


def count_photos(folder: Path) -> int:
    """Return the number of photos below a folder."""
    return len(PhotoFolder(folder, EXTENSIONS | HEIC).others([]))


# --- boxes ---


def boxes_of(request: Boxes, *, required: bool = True) -> list[OrientedBox]:
    """Return the boxes of a request.

    Raises:
        RoiError: there is no box, or too many, two share a name, or `only` names an unknown one.
        ConfigError: the request leaves the box to the scene.
    """
    if AUTO in request.roi:
        raise ConfigError(
            f"--roi {AUTO} is an option of select, suggest, train and run.",
            "Give --rois the rois.json that these write.",
        )
    rois = load_rois(request.rois) if request.rois else []
    refuse_many(len(rois) + len(request.roi))
    rois += [parse_roi(text) for text in request.roi]
    taken = first_taken(roi.name for roi in rois)
    if taken is not None:
        raise RoiError(f"Two boxes are named '{taken}'.", "Give each its own name.")
    rois = _only(rois, request.only)
    if required and not rois:
        raise RoiError("There is no box.", "Add --rois FILE or --roi NAME=x0,y0,z0,x1,y1,z1.")
    return rois


def _only(rois: list[OrientedBox], wanted: Sequence[str]) -> list[OrientedBox]:
    """Return the wanted boxes, or all if none is named; RoiError for an unknown name."""
    names = [roi.name for roi in rois]
    for name in wanted:
        if name not in names:
            hint = f"The boxes are: {', '.join(names)}." if names else "Add --rois or --roi."
            raise RoiError(f"There is no box '{name}'.", hint)
    return [roi for roi in rois if roi.name in wanted] if wanted else rois


@dataclass(frozen=True, kw_only=True)
class BoxSource:
    """The boxes of a request that may leave them to the scene (`--roi auto`)."""

    given: list[OrientedBox] | None  # the boxes; None for one around the main object
    file: Path | None  # file of the automatic box, read again later; None to keep none
    only: tuple[str, ...]  # names of the boxes to use; empty for all

    @staticmethod
    def of(request: Boxes, folder: Path | None) -> BoxSource:
        """Return the source of a request's boxes (`boxes_of`); `folder` keeps an automatic box."""
        file = folder and folder / run_files.BOXES
        if AUTO not in request.roi:
            return BoxSource(given=boxes_of(request), file=None, only=())
        if request.rois or len(request.roi) > 1:
            raise ConfigError(f"--roi {AUTO} replaces all boxes.", "Give it, or boxes.")
        return BoxSource(given=None, file=file, only=request.only)

    @property
    def names(self) -> list[str]:
        """Return the names of the boxes, which are known before the scene."""
        rois = self._kept if self.given is None else self.given
        return [AUTOMATIC_NAME] if rois is None else [roi.name for roi in rois]

    def boxes(self, scene: SfmScene) -> list[OrientedBox]:
        """Return the boxes; errors: `load_rois`, `automatic_box`; RoiError for a bad `only`."""
        if self.given is not None:
            return self.given
        kept = self._kept
        return _only([automatic_box(scene)] if kept is None else kept, self.only)

    def keep(self, rois: Sequence[OrientedBox], context: Context) -> None:
        """Write an automatic box to the file, where the user can change it, and report it."""
        if self.given is not None:
            return
        known = self.file is not None and self.file.exists()
        for roi in rois:
            sides = " x ".join(f"{2 * side:.3g}" for side in roi.half_extents)
            place = ", ".join(f"{value:.3g}" for value in roi.centre)
            how = f"from {self.file}" if known else "around the main object of the photos"
            context.info(f"Box '{roi.name}' {how}: {sides}, centre {place}.")
        if self.file is not None and not known:
            write_text(self.file, rois_document(rois))
            context.info(
                f"To change the box, edit {self.file}; to find it again, delete that file."
            )

    @property
    def _kept(self) -> list[OrientedBox] | None:
        """Return the automatic box of an earlier call, if its file exists."""
        return load_rois(self.file) if self.file is not None and self.file.exists() else None
