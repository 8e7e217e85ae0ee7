"""Layout of a run's training: blocks of the scene, groups of boxes, or one stage.

One stage trains one cell: the surroundings of a block (the Scene-GS of a divided scene), or a group
of boxes with the surroundings nearest to them. The results of cells are joined by their partition.
A run of one block and one group has one cell, which is the whole scene.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace

import numpy as np

from ..context import QUIET, Context
from ..errors import ConfigError
from ..model.ownership import Partition, nearest_owner
from ..model.roi import OrientedBox
from ..model.scene import Float64, Int64, SfmScene
from ..model.visibility import visible_images
from ..selection.cells import (
    Groups,
    Views,
    ground_cells,
    groups_by_photos,
    names_of,
    nearest_group,
    observed_by,
    photos_of_cells,
    rows_named,
    visible_owners,
)
from .config import RunConfig


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """The training data of one stage.

    Attributes:
        share: its photos' share. With boxes: among the photos that see a box of its group, the
            share that sees its own boxes. Without boxes, or for a Scene-GS: its share of all
            photos.
    """

    label: str  # prefix of its stages' names; empty: the whole scene
    photos: tuple[str, ...]  # names of its training photos
    rois: tuple[OrientedBox, ...]
    points: Int64  # rows of the sparse points that its photos observe
    share: float = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Split:
    """A scene divided into cells, and the partition that joins their results."""

    cells: tuple[Cell, ...]
    partition: Partition


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """The cells of a run."""

    groups: Groups  # names of the boxes that are trained together
    blocks: Split | None = None  # cells of the scene stage; None: it is not divided
    cells: Split | None = None  # cells of the stages after it; None: they are not divided
    seen: Mapping[str, Set[str]] = field(default_factory=dict)  # box -> the photos that see it


def lay_out(
    scene: SfmScene,
    rois: Sequence[OrientedBox],
    blocks: int,
    groups: Groups | None,
    context: Context = QUIET,
) -> Layout:
    """Lay out a run; RoiError if no photo sees one of the boxes.

    Args:
        scene, rois: the training photos; the boxes.
        blocks: number of blocks; 1: the scene is not divided.
        groups: names of the boxes of each group; None: group boxes that share photos.
    """
    if blocks == 1 and len(rois) == 1:
        return Layout(groups=((rois[0].name,),))
    seen = {roi.name: set(visible_images(scene, roi, context)) for roi in rois}
    groups = groups or groups_by_photos(seen)
    if blocks == 1 and len(groups) == 1:
        return Layout(groups=groups, seen=seen)
    making = _Making(Views.of(scene, context), rois, seen, groups)
    whole = np.zeros(len(scene.points) + len(scene.images), dtype=np.int64)
    if blocks == 1:
        return Layout(groups=groups, cells=making.grouped(whole, 1), seen=seen)
    block = np.concatenate(ground_cells(making.views, blocks))
    making.keep_boxes_whole(block)
    return Layout(
        groups=groups,
        blocks=making.blocks(block, blocks),
        cells=making.grouped(block, blocks),
        seen=seen,
    )


def given_groups(config: RunConfig, rois: Sequence[OrientedBox]) -> Groups | None:
    """The groups for `lay_out`; None: they are derived from the photos.

    Raises:
        ConfigError: they do not name each box once.
    """
    names = [roi.name for roi in rois]
    if config.strategy != "joint":  # each box has its own stage
        return (tuple(names),)
    if config.groups and sorted(name for group in config.groups for name in group) != sorted(names):
        raise ConfigError(
            "The groups do not name each box once.", f"The boxes are: {', '.join(names)}."
        )
    return config.groups or None


class _Making:
    """Makes the cells of a scene with several blocks or groups of boxes."""

    def __init__(
        self, views: Views, rois: Sequence[OrientedBox], seen: dict[str, set[str]], groups: Groups
    ) -> None:
        self.views, self.scene = views, views.scene
        self.rois, self.seen, self.groups = tuple(rois), seen, groups
        self.places: Float64 = np.concatenate([self.scene.points, self.scene.centres()])
        self.boxed = nearest_owner(self.scene.points, self.rois)  # the box of each point

    def keep_boxes_whole(self, block: Int64) -> None:
        """Assign all points of a box to the block that has most of them, in place."""
        points = block[: len(self.boxed)]
        for index in range(len(self.rois)):
            inside = self.boxed == index
            if inside.any():
                points[inside] = np.bincount(points[inside]).argmax()

    def block_of(self, roi: OrientedBox, block: Int64) -> int:
        inside = self.boxed == self.rois.index(roi)
        rows = inside if inside.any() else roi.contains(self.scene.points)  # in a larger box
        return int(np.bincount(block[: len(self.boxed)][rows]).argmax())

    def blocks(self, block: Int64, count: int) -> Split:
        """The blocks as cells of the Scene-GS."""
        boxes = [
            tuple(roi for roi in self.rois if self.block_of(roi, block) == index)
            for index in range(count)
        ]
        labels = [f"block-{index + 1}" for index in range(count)]
        found = self._split(block, labels, boxes)
        photos = len(self.scene.images)
        cells = tuple(replace(c, share=len(c.photos) / photos) for c in found.cells)
        return replace(found, cells=cells)

    def grouped(self, block: Int64, blocks: int) -> Split:
        """The groups of each block as cells; a block with one group or no boxes is one cell."""
        cells = np.zeros_like(block)
        labels: list[str] = []
        boxes: list[tuple[OrientedBox, ...]] = []
        for index in range(blocks):
            name = f"block-{index + 1}" if blocks > 1 else ""
            there = [r for r in self.rois if blocks == 1 or self.block_of(r, block) == index]
            own = [tuple(r for r in there if r.name in group) for group in self.groups]
            own = [group for group in own if group] or [()]
            rows = block == index
            nearest = nearest_group(self.places[rows], own) if len(own) > 1 else 0
            cells[rows] = len(labels) + nearest
            for number, group in enumerate(own, start=1):
                parts = [name, f"group-{number}" if len(own) > 1 else ""]
                labels.append("-".join(part for part in parts if part))
                boxes.append(group)
        return self._split(cells, labels, boxes)

    def _split(
        self, owner: Int64, labels: Sequence[str], boxes: Sequence[tuple[OrientedBox, ...]]
    ) -> Split:
        """Make cells and their partition from the owner of each point and camera."""
        views, scene = self.views, self.scene
        points, cameras = owner[: len(scene.points)].copy(), owner[len(scene.points) :]
        roi_owner = {roi.name: k for k, own in enumerate(boxes) for roi in own}
        for index, roi in enumerate(self.rois):
            points[self.boxed == index] = roi_owner[roi.name]
        photos = photos_of_cells(views, points, cameras, len(labels))
        for index, own in enumerate(boxes):
            names = set().union(*(self.seen[roi.name] for roi in own))
            photos[:, index] |= rows_named(scene, tuple(names))
        cells = tuple(
            Cell(
                label=label,
                photos=names_of(scene, photos[:, index]),
                rois=boxes[index],
                points=observed_by(views, photos[:, index]),
                share=self._share(int(photos[:, index].sum()), boxes[index]),
            )
            for index, label in enumerate(labels)
        )
        visible = visible_owners(views, points, photos)
        return Split(
            cells=cells,
            partition=Partition(
                points=scene.points,
                owner=np.where(self.boxed >= 0, points, visible),
                rois=self.rois,
                roi_owner=tuple(roi_owner[roi.name] for roi in self.rois),
            ),
        )

    def _share(self, photos: int, boxes: tuple[OrientedBox, ...]) -> float:
        """The `share` of a cell."""
        if not boxes:
            return photos / max(len(self.scene.images), 1)
        group = next(group for group in self.groups if boxes[0].name in group)
        own = set().union(*(self.seen[roi.name] for roi in boxes))
        return len(own) / max(len(set().union(*(self.seen[name] for name in group))), 1)
