"""A run as a value: folder, scene, boxes and settings. Nothing here touches the disk."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..context import QUIET, Context
from ..errors import SceneError
from ..formats.text import counted, in_gb
from ..machine import machine_memory
from ..model.local_frame import LocalFrame
from ..model.mask_coverage import with_useful_masks
from ..model.roi import OrientedBox
from ..model.scene import SfmScene
from ..model.visibility import check_has_points
from ..requests.choices import MOST_BLOCKS, TEST, VALIDATION
from ..selection.manual import usable_manual
from ..selection.split import choose_test_views
from .config import AUTO_BLOCKS, RunConfig
from .layout import Layout, given_groups, lay_out

if TYPE_CHECKING:
    from .memory import MemoryPlan

MANIFEST_VERSION = 4  # increase it if an older run folder cannot be resumed
FEWEST = 24  # photos of a block; with fewer, nothing determines its surroundings
USELESS = 0.9  # of all photos, in the median block: above this share, blocks save almost nothing


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """Everything that decides a run's results, and its folder.

    Attributes:
        scene: all photos, test photos included; in the local frame.
        rois: the boxes, in the local frame.
        test: names of the test photos. Only the evaluation uses them. If there are validation
            photos, they are not used at all.
        validation: names of the validation photos, which replace the test photos in the evaluation;
            empty if the run is evaluated on test photos.
        manual: box -> its photos, best first, for boxes with a manual selection.
        frame: the local frame, used for all computation; files are in the world's frame.
        inputs: the scene and the boxes for the manifest (`inputs_record`).
    """

    folder: Path
    scene: SfmScene
    rois: tuple[OrientedBox, ...]
    config: RunConfig
    frame: LocalFrame
    inputs: Mapping[str, Any]
    test: tuple[str, ...] = ()
    validation: tuple[str, ...] = ()
    manual: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @cached_property
    def train_scene(self) -> SfmScene:
        """The scene without its test and validation photos."""
        return self.scene.without({*self.test, *self.validation})

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the photos that the evaluation measures: validation or test photos."""
        return self.validation if self.config.evaluate_on == VALIDATION else self.test

    def split(self) -> dict[str, Any]:
        """The photos to evaluate on, as JSON values."""
        record = {"evaluate_on": self.config.evaluate_on, TEST: list(self.test)}
        return record | ({VALIDATION: list(self.validation)} if self.validation else {})

    @property
    def test_scene(self) -> SfmScene:
        """The scene with its test and validation photos only."""
        return self.scene.select((*self.test, *self.validation))

    @cached_property
    def layout(self) -> Layout:
        """The blocks of the scene and groups of boxes; RoiError if no photo sees a box."""
        groups = given_groups(self.config, self.rois)
        return lay_out(self.train_scene, self.rois, self.config.blocks, groups)

    def memory(self, context: Context = QUIET) -> MemoryPlan:
        """Estimate the memory of the run; SceneError if this machine or its GPU has too little."""
        from .memory import layout_memory, with_card  # imports torch

        plan = layout_memory(self.scene, self.layout, self.config, context.photo_memory)
        return with_card(plan, self.scene, self.layout, context)

    @cached_property
    def extent(self) -> float:
        """The extent of the training cameras, local units (`SfmScene.extent`)."""
        return self.train_scene.extent()

    def manifest(self) -> dict[str, Any]:
        """Everything that decides the results, as JSON values."""
        config = self.config.to_dict()
        record = {"version": MANIFEST_VERSION, "config": config, **self.inputs}
        record |= {"manual": dict(self.manual)} if self.manual else {}
        groups = [list(group) for group in self.layout.groups]
        return record | ({"groups": groups} if len(groups) > 1 else {})


def inputs_record(scene: SfmScene, rois: Sequence[OrientedBox]) -> dict[str, Any]:
    """The manifest's entries for a scene and its boxes, both in the world's frame."""
    images = scene.images
    masks = {image.name: image.mask.digest for image in images if image.mask is not None}
    objects: dict[str, dict[str, str]] = {}
    for roi in rois:
        found = {i.name: i.objects[roi.name].digest for i in images if roi.name in i.objects}
        objects |= {roi.name: found} if found else {}
    record = {
        "rois": [roi.to_dict() for roi in rois],
        "photos": len(images),
        "sizes": sorted({f"{i.camera.width}x{i.camera.height}" for i in images}),
        "model": scene.digest()[:16],
        "contents": {image.name: image.file_digest or image.digest for image in images},
    }
    levelled = {image.name: image.exposure for image in images if image.exposure}
    record |= {"exposures": levelled} if levelled else {}
    record |= {"masks": masks} if masks else {}
    return record | ({"object_masks": objects} if objects else {})


def define_run(
    folder: Path,
    scene: SfmScene,
    rois: Sequence[OrientedBox],
    config: RunConfig,
    *,
    manual: Mapping[str, Sequence[str]] | None = None,
    context: Context = QUIET,
) -> Run:
    """Define the run of these inputs; chooses its test photos and, if needed, validation photos.

    Args:
        folder, config, manual: see `Run`.
        scene, rois: in the world's frame.
        context: gets a warning for manual photos that cannot be used.

    Raises:
        SceneError: the model has no points, or too few photos see a box to choose test and
            validation photos.
        RoiError: no point lies in a box, or no photo sees its points.
        ConfigError: `manual` names photos that cannot be used.
        Stopped: on request.
    """
    if len(scene.points) == 0:
        raise SceneError("The model has no 3D points.", "Triangulate it in COLMAP first.")
    for roi in rois:
        check_has_points(scene, roi)  # its message has coordinates of the world's frame
    scene = with_useful_masks(scene, rois, context)
    frame = LocalFrame.of_scene(scene)
    local, boxes = frame.scene(scene), tuple(frame.box(roi) for roi in rois)
    test = choose_test_views(local, boxes, config.test_every, context)
    validation: tuple[str, ...] = ()
    if config.evaluate_on == VALIDATION:
        others = local.without(set(test))
        try:
            validation = choose_test_views(others, boxes, config.test_every, context)
        except SceneError as error:
            message = f"No validation photos can be chosen beside the test photos. {error.message}"
            raise SceneError(message, error.hint) from error
    usable = {
        roi: usable_manual(names, local, (*test, *validation), roi, context)
        for roi, names in (manual or {}).items()
    }
    blocks = number_of_blocks(local, local.without({*test, *validation}), boxes, config, context)
    return Run(
        folder=folder,
        scene=local,
        rois=boxes,
        config=replace(config, blocks=blocks),
        test=test,
        validation=validation,
        manual=usable,
        frame=frame,
        inputs=inputs_record(scene, rois),
    )


# --- number of blocks ---


def number_of_blocks(
    scene: SfmScene,
    train: SfmScene,
    rois: tuple[OrientedBox, ...],
    config: RunConfig,
    context: Context = QUIET,
) -> int:
    """The number of blocks for a run: as requested, or fewer with a warning that says why.

    `scene` includes the test photos, `train` does not. RoiError if no photo sees one of the boxes.
    """
    if config.blocks == 1:
        return 1
    groups = given_groups(config, rois)
    layouts = _Layouts(train, lambda count: lay_out(train, rois, count, groups, context))
    if config.blocks == AUTO_BLOCKS:
        return _by_memory(scene, layouts, config, context)
    found = next(n for n in range(config.blocks, 0, -1) if n == 1 or layouts.fewest(n) >= FEWEST)
    if found < config.blocks:
        what = f"into {found} blocks instead of {config.blocks}"
        divided = found > 1
        what = f"The scene is divided {what}" if divided else "The scene is not divided into blocks"
        context.warn(
            f"{what}: of {counted(len(train.images), 'photo')}, one of {found + 1} blocks would"
            f" have fewer than {FEWEST}."
        )
    if found > 1 and layouts.usual(found) > USELESS:
        context.warn(
            f"Blocks save little here: {layouts.usual(found):.0%} of the photos show the usual "
            "block, as in photos taken around one object."
        )
    return found


class _Layouts:
    """Layouts of a scene for each number of blocks, cached."""

    def __init__(self, scene: SfmScene, made: Callable[[int], Layout]) -> None:
        self.scene, self.of = scene, cache(made)

    def photos(self, count: int) -> list[int]:
        """Number of photos in each block, ascending."""
        blocks = self.of(count).blocks
        return sorted(len(c.photos) for c in blocks.cells) if blocks else [len(self.scene.images)]

    def fewest(self, count: int) -> int:
        return self.photos(count)[0]

    def usual(self, count: int) -> float:
        """Share of the photos in the median block."""
        photos = self.photos(count)
        return photos[len(photos) // 2] / max(len(self.scene.images), 1)


def _by_memory(scene: SfmScene, layouts: _Layouts, config: RunConfig, context: Context) -> int:
    """The smallest number of blocks that fits into this machine's memory; 1 if none does."""
    machine = machine_memory()
    needed = _needed(scene, layouts.of(1), config, context)
    if needed <= machine:
        return 1
    for count in range(2, MOST_BLOCKS + 1):
        context.check_cancelled()
        if layouts.fewest(count) < FEWEST:
            break
        if layouts.usual(count) <= USELESS:
            each = _needed(scene, layouts.of(count), config, context)
            if each <= machine:
                whole = in_gb(int(needed)) if math.isfinite(needed) else "more"
                context.info(
                    f"The scene is divided into {count} blocks that need {in_gb(int(each))} "
                    f"each; as one it would need {whole}, and this machine has {in_gb(machine)}."
                )
                return count
    reason = (
        "the photos all show most of it"
        if layouts.usual(2) > USELESS
        else f"blocks with {FEWEST} photos or more do not fit either"
    )
    context.warn(f"The scene is not divided into blocks: {reason}. Use a smaller --max-side.")
    return 1


def _needed(scene: SfmScene, layout: Layout, config: RunConfig, context: Context) -> float:
    """Bytes that training needs; infinite if even its start does not fit."""
    from .memory import layout_memory  # imports torch

    settings = replace(config, blocks=1)
    try:
        return layout_memory(scene, layout, settings, context.photo_memory).total
    except SceneError:
        return math.inf
