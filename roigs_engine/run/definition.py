"""A run as a value: its folder, scene, boxes and settings. Nothing here touches the disk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..context import QUIET, Context
from ..errors import SceneError
from ..model.local_frame import LocalFrame
from ..model.mask_coverage import with_useful_masks
from ..model.roi import OrientedBox
from ..model.scene import SfmScene
from ..model.visibility import check_has_points
from ..requests.choices import TEST, VALIDATION
from ..selection.manual import usable_manual
from ..selection.split import choose_test_views
from .config import RunConfig
from .layout import Layout, given_groups, lay_out, number_of_blocks

if TYPE_CHECKING:
    from .memory import MemoryPlan

MANIFEST_VERSION = 4  # increase it if an older run folder cannot be resumed


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """Everything that decides a run's results, and its folder.

    Attributes:
        folder: the run folder.
        scene: all photos, test photos included; in the local frame.
        rois: the boxes, in the local frame.
        config: settings.
        test: names of the test photos. Only the evaluation uses them; with validation photos,
            nothing does.
        validation: names of the validation photos, which replace the test photos in the evaluation;
            empty if the run is evaluated on test photos.
        manual: box -> its photos, best first, for boxes with a manual selection.
        frame: the local frame, in which everything is computed; files are in the world's.
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
        """Which photos are evaluated on; ready for JSON."""
        record = {"evaluate_on": self.config.evaluate_on, TEST: list(self.test)}
        return record | ({VALIDATION: list(self.validation)} if self.validation else {})

    @property
    def test_scene(self) -> SfmScene:
        """The scene with its test and validation photos only."""
        return self.scene.select((*self.test, *self.validation))

    @cached_property
    def layout(self) -> Layout:
        """Blocks of the scene and groups of boxes; RoiError if no photo sees a box."""
        groups = given_groups(self.config, self.rois)
        return lay_out(self.train_scene, self.rois, self.config.blocks, groups)

    def memory(self, context: Context = QUIET) -> MemoryPlan:
        """The memory that it needs; SceneError if this machine, or its GPU, has less."""
        from .memory import layout_memory, with_card  # with torch

        plan = layout_memory(self.scene, self.layout, self.config, context.photo_memory)
        return with_card(plan, self.scene, self.layout, context)

    @cached_property
    def extent(self) -> float:
        """Extent of the training cameras, local units (`SfmScene.extent`)."""
        return self.train_scene.extent()

    def manifest(self) -> dict[str, Any]:
        """Everything that decides the results; ready for JSON."""
        config = self.config.to_dict()
        record = {"version": MANIFEST_VERSION, "config": config, **self.inputs}
        record |= {"manual": dict(self.manual)} if self.manual else {}
        groups = [list(group) for group in self.layout.groups]
        return record | ({"groups": groups} if len(groups) > 1 else {})


def inputs_record(scene: SfmScene, rois: Sequence[OrientedBox]) -> dict[str, Any]:
    """A scene and its boxes, both in the world's frame, in a manifest."""
    images = scene.images
    masks = {image.name: image.mask.digest for image in images if image.mask is not None}
    objects = {
        roi.name: {
            image.name: image.objects[roi.name].digest
            for image in images
            if roi.name in image.objects
        }
        for roi in rois
    }
    objects = {box: found for box, found in objects.items() if found}
    record = {
        "rois": [roi.to_dict() for roi in rois],
        "photos": len(images),
        "sizes": sorted({f"{i.camera.width}x{i.camera.height}" for i in images}),
        "model": scene.digest()[:16],
        "contents": {image.name: image.file_digest or image.digest for image in images},
    }
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
    """The run of these inputs; chooses its test photos, and validation photos if it has any.

    Args:
        folder, config: see `Run`.
        scene, rois: in the world's frame.
        manual: box -> photos, best first, for boxes with a manual selection.
        context: gets a warning for manual photos that cannot be used.

    Raises:
        SceneError: the model has no points, or too few photos see a box to choose test and
            validation photos.
        RoiError: no point lies in a box, or no photo sees one that does.
        ConfigError: `manual` names photos that cannot be used.
        Stopped: on request.
    """
    if len(scene.points) == 0:
        raise SceneError("The model has no 3D points.", "Triangulate it in COLMAP first.")
    for roi in rois:
        check_has_points(scene, roi)  # its message is in the world's frame
    scene = with_useful_masks(scene, rois, context)
    frame = LocalFrame.of_scene(scene)
    local, boxes = frame.scene(scene), tuple(frame.box(roi) for roi in rois)
    test = choose_test_views(local, boxes, config.test_every, context)
    validation: tuple[str, ...] = ()
    if config.evaluate_on == VALIDATION:
        validation = _validation_views(local, boxes, config.test_every, test, context)
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


def _validation_views(
    scene: SfmScene,
    rois: Sequence[OrientedBox],
    every: int,
    test: Sequence[str],
    context: Context,
) -> tuple[str, ...]:
    """Names of the validation photos: chosen like test photos, from those that are none."""
    try:
        return choose_test_views(scene.without(set(test)), rois, every, context)
    except SceneError as error:
        message = f"No validation photos can be chosen beside the test photos. {error.message}"
        raise SceneError(message, error.hint) from error
