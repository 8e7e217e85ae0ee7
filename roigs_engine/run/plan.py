"""The plan of a run as data: a graph of stages, and the models made from their results.

Pure functions of scene, boxes and settings make the plan (`strategies.py`) before anything is
trained; `executor.py` executes it. A stage's fingerprint depends on the plan alone: it hashes the
stage's settings and photos, and the fingerprints of the stages that it starts from.
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

from ..formats.text import json_digest
from ..model.ownership import Partition
from ..model.roi import OrientedBox
from ..model.scene import Int64, PosedImage
from ..selection import CameraSelection
from ..training.config import TrainConfig
from ..training.photo_order import PhotoOrder

POINTS, RESULT, CROP, MERGE = "points", "result", "crop", "merge"
CELLS, SEEN = "cells", "seen"


@dataclass(frozen=True, kw_only=True, eq=False)
class Source:
    """A source of Gaussians.

    Attributes:
        kind: `points` (the sparse points), `result` (of the one input), `crop` (the base's
            Gaussians in the one box), `merge` (the base, with the content of the k-th box taken
            from input k), `cells` (from each input, the Gaussians that it owns) or `seen` (the
            base's Gaussians that photos show).
        digest: for `points`, hash of the sparse points; for `cells`, of the partition; for `merge`,
            of the masks of the boxes' objects, which decide the boxes' content (empty: no masks).
    """

    kind: str
    base: Source | None = None  # the start of `crop`, `merge` and `seen`
    inputs: tuple[Stage, ...] = ()  # stages, without those of the base
    rois: tuple[OrientedBox, ...] = ()  # boxes, for `crop` and `merge`
    digest: str = ""
    rows: Int64 | None = None  # of the sparse points, for `points`; None: all
    partition: Partition | None = None  # of the inputs, for `cells`
    images: tuple[PosedImage, ...] = ()  # the photos, for `seen`
    share: float = 1.0  # share of the sparse points that these observe; only for estimates

    @property
    def stages(self) -> tuple[Stage, ...]:
        """All stages that the Gaussians come from, those of the base first."""
        return (*(self.base.stages if self.base else ()), *self.inputs)

    @cached_property
    def fingerprint(self) -> str:
        """A text that identifies the Gaussians."""
        if self.kind == RESULT:
            return self.inputs[0].fingerprint
        parts = [self.base.fingerprint] if self.base else []
        parts += [stage.fingerprint for stage in self.inputs]
        if self.images:
            parts.append(json_digest([camera_record(image) for image in self.images]))
        return ":".join([self.kind, self.digest, *parts])


@dataclass(frozen=True, kw_only=True, eq=False)
class Stage:
    """One training stage."""

    name: str  # unique in the plan, for example `compare-joint/scene`
    images: tuple[PosedImage, ...]  # the photos, with cameras of the size used for training
    config: TrainConfig
    start: Source
    order: PhotoOrder
    extent: float  # extent of the scene, world units
    seed: int  # for the positions of split Gaussians
    rois: tuple[OrientedBox, ...] = ()  # boxes that limit densification and masks

    @cached_property
    def fingerprint(self) -> str:
        """Hash of everything that decides the stage's result; without the boxes' names."""
        record: dict[str, Any] = {
            "config": self.config.to_dict(planned=True),
            "mechanisms": [each.name for each in self.config.mechanisms],  # in their order
            "images": [_image_record(image) for image in self.images],
            "rois": [roi.to_dict() | {"name": ""} for roi in self.rois],
            "objects": self._object_masks(),
            "extent": self.extent,
            "seed": self.seed,
            "start": self.start.fingerprint,
            "order": asdict(self.order),
        }
        return json_digest(record)

    def _object_masks(self) -> list[tuple[int, int, str]]:
        """The masks of objects that the stage uses: photo, box, digest of the mask."""
        if not any(each.uses_object_masks for each in self.config.mechanisms):
            return []
        return [
            (row, box, image.objects[roi.name].digest)
            for row, image in enumerate(self.images)
            for box, roi in enumerate(self.rois)
            if roi.name in image.objects
        ]

    def start_share(self, points: int) -> float:
        """Share of the scene (with `points` sparse points) that it starts with, about."""
        rows = self.start.rows
        return self.start.share if rows is None else max(len(rows), 1) / max(points, 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedModel:
    """A model to train, one row of the report's tables."""

    name: str  # unique among the rows of a box
    source: Source
    stages: tuple[Stage, ...] = ()  # stages that all boxes share
    by_roi: dict[str, tuple[Stage, ...]] = field(default_factory=dict)  # box -> its own stages

    @property
    def rois(self) -> tuple[str, ...] | None:
        """The boxes that get a row for it; None: all boxes, because it has shared stages."""
        return None if self.stages else tuple(self.by_roi)

    @property
    def all_stages(self) -> tuple[Stage, ...]:
        """All stages whose time its row counts."""
        return (*self.stages, *(stage for own in self.by_roi.values() for stage in own))

    @classmethod
    def of_stages(cls, name: str, *stages: Stage, roi: str = "") -> PlannedModel:
        """The result of the last of these stages, for one box or for all."""
        source = result_of(stages[-1])
        if roi:
            return cls(name=name, source=source, by_roi={roi: stages})
        return cls(name=name, source=source, stages=stages)


@dataclass(frozen=True, kw_only=True, eq=False)
class Output:
    """PLY files to write once a model is trained."""

    folder: str  # below the run folder; empty: the run folder itself
    model: PlannedModel  # the result
    coarse: Source  # the Scene-GS; its Gaussians in each box are written for comparison


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Stages, models and files. Plans can be added.

    `selections`: folder below the run folder -> the selected photos of each box there.
    """

    models: tuple[PlannedModel, ...] = ()  # in the order of the tables, the result last
    outputs: tuple[Output, ...] = ()  # the files to write
    selections: dict[str, tuple[CameraSelection, ...]] = field(default_factory=dict)

    def __add__(self, other: Plan) -> Plan:
        return Plan(
            models=self.models + other.models,
            outputs=self.outputs + other.outputs,
            selections=self.selections | other.selections,
        )

    @cached_property
    def in_training_order(self) -> tuple[PlannedModel, ...]:
        """The models; those written to files come first, because users wait for them."""
        written = [output.model for output in reversed(self.outputs)]
        return (*written, *(model for model in self.models if model not in written))

    @cached_property
    def stages(self) -> tuple[Stage, ...]:
        """Each stage once, in the order of training; after the stages that it needs."""
        found: dict[str, Stage] = {}

        def visit(stage: Stage) -> None:
            for needed in stage.start.stages:
                visit(needed)
            found.setdefault(stage.name, stage)

        for model in self.in_training_order:
            for stage in (*model.all_stages, *model.source.stages):
                visit(stage)
        return tuple(found.values())


def result_of(stage: Stage) -> Source:
    return Source(kind=RESULT, inputs=(stage,))


def camera_record(image: PosedImage) -> tuple[Any, ...]:
    """The numbers that decide which Gaussians a photo shows."""
    return asdict(image.camera), image.world_to_camera.tolist()


def _image_record(image: PosedImage) -> tuple[Any, ...]:
    """Everything about a photo that affects a stage's training."""
    mask = image.mask.digest if image.mask else ""
    observed = hashlib.sha256(image.point_indices.astype("<i8").tobytes()).hexdigest()
    return image.name, image.digest, *camera_record(image), image.pixel_size, mask, observed
