"""The training photos of a run, and which of them see which box; each is computed once."""

from __future__ import annotations

from collections.abc import Set
from copy import copy

from ..context import QUIET, Context
from ..model.roi import OrientedBox
from ..model.scene import PosedImage
from ..model.visibility import visible_images
from ..selection import CameraSelection, select_cameras
from ..selection.config import SelectionConfig
from ..selection.manual import manual_selection
from ..selection.split import interleaved, reserved
from .definition import Run
from .layout import Cell


class PhotoSets:
    """The training photos of a run and their subsets, in the scene's order.

    Attributes:
        images: all training photos, or those of a cell.
        rois: all boxes, or those of a cell.
    """

    def __init__(self, run: Run, context: Context = QUIET) -> None:
        self.run = run
        self.images = run.train_scene.images
        self.rois = run.rois
        self.context = context
        self._selections: dict[str, CameraSelection] = {}
        self._seen: dict[str, Set[str]] = {}

    def of(self, cell: Cell) -> PhotoSets:
        """The photos and boxes of a cell."""
        part, names = copy(self), set(cell.photos)
        part.images = tuple(image for image in self.images if image.name in names)
        part.rois = cell.rois
        return part

    def selection(self, roi: OrientedBox) -> CameraSelection:
        """The box's photos, best first: the manual selection, or the method's."""
        if roi.name not in self._selections:
            self._selections[roi.name] = self._select(roi, self.run.config.selection)
        return self._selections[roi.name]

    def _select(self, roi: OrientedBox, config: SelectionConfig) -> CameraSelection:
        scene, manual = self.run.train_scene, self.run.manual
        if roi.name in manual:
            return manual_selection(scene, roi, manual[roi.name], self.context)
        return select_cameras(scene, roi, config, self.context, tests=self.run.test_scene)

    def selections(self) -> tuple[CameraSelection, ...]:
        """The selections of the boxes, in their order."""
        return tuple(self.selection(roi) for roi in self.rois)

    def selected(self) -> set[str]:
        """Names of the photos selected for any of the boxes."""
        return set(interleaved([chosen.names for chosen in self.selections()]))

    def reserved(self) -> set[str]:
        """Names of the selected photos that the Scene-GS must not use (paper, sec. II-B)."""
        orders = [chosen.names for chosen in self.selections()]
        return reserved(orders, self.run.config.kept_share)

    def seen(self, roi: OrientedBox) -> tuple[PosedImage, ...]:
        """The training photos that see the box."""
        if roi.name not in self._seen:
            known = self.run.layout.seen.get(roi.name)
            self._seen[roi.name] = known or self._visible(roi)
        names = self._seen[roi.name]
        return tuple(image for image in self.images if image.name in names)

    def _visible(self, roi: OrientedBox) -> set[str]:
        return set(visible_images(self.run.train_scene, roi, self.context))
