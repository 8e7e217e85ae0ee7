"""A run as a value: its folder, scene, boxes and settings. Nothing here touches the disk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from ..context import QUIET, Context
from ..errors import SceneError
from ..model.roi import OrientedBox
from ..model.scene import SfmScene
from ..selection.manual import usable_manual
from ..selection.split import choose_test_views
from .config import RunConfig

MANIFEST_VERSION = 2  # increase it if an older run folder cannot be resumed


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """Everything that decides a run's results, and its folder.

    Attributes:
        folder: the run folder.
        scene: all photos, test photos included.
        rois: the boxes.
        config: settings.
        test: names of the test photos, which only the evaluation uses.
        manual: box -> its photos, best first, for boxes with a manual selection.
    """

    folder: Path
    scene: SfmScene
    rois: tuple[OrientedBox, ...]
    config: RunConfig
    test: tuple[str, ...] = ()
    manual: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @cached_property
    def train_scene(self) -> SfmScene:
        """The scene without its test photos."""
        return self.scene.without(set(self.test))

    @cached_property
    def extent(self) -> float:
        """Extent of the training cameras, world units (`SfmScene.extent`)."""
        return self.train_scene.extent()

    def manifest(self) -> dict[str, Any]:
        """Everything that decides the results; ready for JSON."""
        images = self.scene.images
        record = {
            "version": MANIFEST_VERSION,
            "config": self.config.to_dict(),
            "rois": [roi.to_dict() for roi in self.rois],
            "photos": len(images),
            "sizes": sorted({f"{i.camera.width}x{i.camera.height}" for i in images}),
            "model": self.scene.digest()[:16],
            "contents": {image.name: image.digest for image in images},
        }
        return record | ({"manual": dict(self.manual)} if self.manual else {})


def define_run(
    folder: Path,
    scene: SfmScene,
    rois: Sequence[OrientedBox],
    config: RunConfig,
    *,
    manual: Mapping[str, Sequence[str]] | None = None,
    context: Context = QUIET,
) -> Run:
    """The run of these inputs; chooses its test photos.

    Args:
        folder, scene, rois, config: see `Run`.
        manual: box -> photos, best first, for boxes with a manual selection.
        context: gets a warning for manual photos that cannot be used.

    Raises:
        SceneError: the model has no points, or too few photos see a box to choose a test photo.
        RoiError: no point lies in a box, or no photo sees one that does.
        ConfigError: `manual` names photos that cannot be used.
        Stopped: on request.
    """
    if len(scene.points) == 0:
        raise SceneError("The model has no 3D points.", "Triangulate it in COLMAP first.")
    test = choose_test_views(scene, rois, config.test_every, context)
    usable = {
        roi: usable_manual(names, scene, test, roi, context)
        for roi, names in (manual or {}).items()
    }
    return Run(
        folder=folder, scene=scene, rois=tuple(rois), config=config, test=test, manual=usable
    )
