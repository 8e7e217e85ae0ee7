"""A whole run: scene + boxes + config -> selections, stages, one model, in one run folder.

The run folder:

    request.json            settings of the run; another request is refused
    split.json              the test photos, which nothing but the evaluation sees
    selection/ROI.json      ordered photos of each box
    scene/ joint/ object-ROI/ seam/ full-scene/ full-object-ROI/ matched-scene/
                            stages (see `stages.py`)
    independent/            the other strategy's run, when it is compared with
    result.ply              the run's result
    surroundings.ply rois/ROI.ply coarse/ROI.ply    it in parts; Scene-GS in each box
    preview.ply             the Gaussians of the stage that is being trained
    older/                  what was made for other requests
    report.md report.json crops/    the evaluation
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from itertools import starmap
from pathlib import Path
from typing import Any

import torch

from ..cuda.device import CPU
from ..errors import SceneError
from ..formats.events import Emit, Message, check_of, ignore
from ..formats.files import write_json
from ..model.compose import cut, surroundings
from ..model.compose import replace as replace_in_boxes
from ..model.gaussians import Gaussians
from ..model.roi import OrientedBox
from ..model.scene import PosedImage, SfmScene
from ..photos.cache import PhotoCache
from ..selection import CameraSelection, select_cameras, shares, visible_images
from ..selection.manual import check_given, given_selection
from ..selection.split import choose_test_views
from ..training import photo_order
from ..training.budget import box_capacities, capacities_to
from ..training.config import TrainConfig
from ..training.masks import Regions
from ..training.photo_order import PhotoAt
from ..training.stage import Stage, StageResult, fingerprint
from ..training.trainer import StageData
from ..training.view_spacing import detail_spacing, photo_spacing, rates_for_spacing
from . import stage_configs, strategies
from .config import STRATEGIES, RunConfig
from .manifest import claim
from .memory import plan_memory
from .presets import in_strategy
from .scene_warnings import cautions
from .strategies import TrainedModel


class Run:
    """One run folder and what is to be done in it."""

    def __init__(
        self,
        folder: Path,
        scene: SfmScene,
        rois: Sequence[OrientedBox],
        config: RunConfig,
        *,
        given: Mapping[str, Sequence[str]] | None = None,
        update: bool = False,
        preview_seconds: float = 0.0,
        image_cache: int | None = None,
        device: torch.device = CPU,
        emit: Emit = ignore,
        should_stop: Callable[[], bool] = lambda: False,
    ) -> None:
        """Claim `folder` for this request.

        Args:
            folder, scene, rois, config: of the run.
            given: box -> photos, best first, where they are not to be selected.
            update: take a folder of another request over: what still fits is kept, the rest goes
                to its folder `older`.
            preview_seconds: of training between two writings of `preview.ply`; 0: never.
            image_cache: bytes of decoded photos to keep; None: as `plan_memory` says.
            device: where to train; no part of the request.
            emit, should_stop: as everywhere.

        Raises:
            RunFolderError: the folder holds a run with other settings.
            SceneError: no photo sees a box, too few photos are there to test on, or the scene does
                not fit into the machine's memory.
            ConfigError: `given` names photos that cannot be used.
            Stopped: `should_stop` said so.
        """
        self.folder, self.scene, self.rois, self.config = folder, scene, list(rois), config
        self._emit, self._should_stop, self._check = emit, should_stop, check_of(should_stop)
        self._update, self._preview_seconds = update, preview_seconds
        self.device = device
        if len(scene.points) == 0:
            raise SceneError("The model holds no 3D points.", "Triangulate it in COLMAP first.")
        self._image_cache = image_cache
        self.memory = plan_memory(scene.images, len(scene.points), config, image_cache)
        self.test = choose_test_views(scene, self.rois, config.test_every, self._check)
        self.given = {
            roi: check_given(names, scene, self.test, roi, emit)
            for roi, names in (given or {}).items()
        }
        claim(folder, self._request(), update=update, emit=emit)
        write_json(folder / "split.json", {"test": list(self.test)})
        self.train_scene = scene.without(set(self.test))
        self.extent = self.train_scene.extent()
        for caution in cautions(self.train_scene, self.rois):
            emit(Message(text=caution, level="warning"))
        self._photos: dict[tuple[tuple[str, int], ...], PhotoCache] = {}
        self._selections: dict[str, CameraSelection] = {}
        self._visible: dict[str, tuple[str, ...]] = {}

    def _request(self) -> dict[str, Any]:
        """What decides the results, beside the photos' pixels."""
        images = self.scene.images
        request = {
            "config": self.config.to_dict(),
            "rois": [roi.to_dict() for roi in self.rois],
            "photos": len(images),
            "sizes": sorted({f"{i.camera.width}x{i.camera.height}" for i in images}),
            "model": self.scene.digest()[:16],
        }
        return request | ({"given": self.given} if self.given else {})

    # --- selection ---

    def selection(self, roi: OrientedBox) -> CameraSelection:
        """The box's photos, best first; computed once and kept in the run folder."""
        if roi.name not in self._selections:
            chosen = self._chosen(roi)
            write_json(self.folder / "selection" / f"{roi.name}.json", chosen.to_dict())
            self._selections[roi.name] = chosen
        return self._selections[roi.name]

    def _chosen(self, roi: OrientedBox) -> CameraSelection:
        if roi.name in self.given:
            return given_selection(self.train_scene, roi, self.given[roi.name], self._check)
        config = self.config.selection
        return select_cameras(self.train_scene, roi, config, self._emit, self._check)

    def _orders(self) -> list[tuple[str, ...]]:
        return [self.selection(roi).names for roi in self.rois]

    # --- stages ---

    def scene_stage(self) -> StageResult:
        """Scene-GS (paper, sec. II-B): all photos but those reserved for the boxes."""
        held = shares.reserved(self._orders(), self.config.kept_share)
        names = [i.name for i in self.train_scene.images if i.name not in held]
        if not names:
            raise SceneError(
                "Every photo is reserved for a box: none is left to train the scene on.",
                "Raise --kept-share (1 keeps all), or select fewer photos (--count).",
            )
        return self._train("scene", names, self.config.scene, scale=self.config.scene_scale)

    def full_scene(self) -> StageResult:
        """Baseline: standard 3DGS on all training photos, as many steps as both stages."""
        names = [i.name for i in self.train_scene.images]
        return self._train("full-scene", names, stage_configs.baseline(self.config))

    def full_object(self, roi: OrientedBox) -> StageResult:
        """Baseline: standard 3DGS on every photo that sees the box."""
        names = list(self._seen(roi))
        return self._train(f"full-object-{roi.name}", names, stage_configs.baseline(self.config))

    def matched_scene(self, counts: Mapping[str, int]) -> StageResult:
        """Baseline: Full Scene with as many Gaussians in the boxes as another model has there.

        In the boxes it densifies more readily than the ROI stage. What it loses to that model is
        not for want of Gaussians.

        Args:
            counts: box -> most Gaussians that belong to it; where boxes overlap, to one of them.
        """
        names = [i.name for i in self.train_scene.images]
        config = stage_configs.matched_baseline(self.config)
        return self._train("matched-scene", names, config, rois=self.rois, counts=counts)

    def object_stage(self, roi: OrientedBox) -> StageResult:
        """Object-GS of one box (paper, sec. II-B): its selected photos, densified in the box."""
        names = list(self.selection(roi).names)
        return self._train(
            f"object-{roi.name}",
            names,
            stage_configs.object_stage(self.config),
            rois=[roi],
            start=self._start([roi]),
            ordered=self.config.roi_order == "ordered",
        )

    def seam_stage(self, scene: StageResult, objects: Sequence[StageResult]) -> StageResult:
        """The composition, trained on as a whole (ours): inside and outside come to meet."""
        parts = ",".join(stage.fingerprint for stage in (scene, *objects))
        return self._train(
            "seam",
            [i.name for i in self.train_scene.images],
            stage_configs.refine_stage(self.config),
            rois=self.rois,
            start=(self.composed(scene, objects), f"composition:{parts}"),
            selected=self._selected(),
        )

    def composed(self, scene: StageResult, objects: Sequence[StageResult]) -> Gaussians:
        """The Scene-GS with every box's inside taken from its Object-GS."""
        pairs = zip(self.rois, objects, strict=True)
        return replace_in_boxes(scene.gaussians, [(roi, stage.gaussians) for roi, stage in pairs])

    def joint_stage(self) -> StageResult:
        """One stage for all boxes: all photos and the selected ones, densified in the boxes."""
        return self._train(
            "joint",
            [i.name for i in self.train_scene.images],
            self.config.roi,
            rois=self.rois,
            start=self._start(self.rois),
            selected=self._selected(),
        )

    def _selected(self) -> set[str]:
        return set(shares.interleaved(self._orders()))

    def _train(
        self,
        name: str,
        photos: list[str],
        config: TrainConfig,
        *,
        rois: Sequence[OrientedBox] = (),
        start: tuple[Gaussians, str] | None = None,
        selected: set[str] | None = None,
        ordered: bool = False,
        counts: Mapping[str, int] | None = None,
        scale: float = 1.0,
    ) -> StageResult:
        """Run one stage.

        Args:
            name, photos, config, rois: of the stage.
            start: Gaussians, and a name for them; None: the sparse points.
            selected: photos that are drawn more often; None: all are drawn as often.
            ordered: photos follow one another as they stand instead.
            counts: box -> Gaussians it comes to hold at most; None: as the config says.
            scale: the photos are used at this share of their size.
        """
        margins = [roi.scaled(config.box_margin) for roi in rois]
        if config.lr_shN_spacing:
            around = [(self._images_of(roi), roi) for roi in rois]
            spacing = max(starmap(photo_spacing, around))
            config = rates_for_spacing(config, spacing, max(starmap(detail_spacing, around)))
        by_name = {image.name: image for image in self.train_scene.images}
        images = [by_name[photo].scaled(scale) for photo in photos]
        if selected is not None:
            photo_at, order = self._mixed(images, config, selected)
        elif ordered:
            photo_at, order = photo_order.ordered(range(len(images))), ["ordered"]
        else:
            seed = self.config.seed
            photo_at, order = photo_order.shuffled(range(len(images)), seed), ["shuffled", seed]
        model, start_name = self._points() if start is None else start
        if counts is None:
            capacities = box_capacities(model, images, margins, config, self._check)
        else:
            capacities = capacities_to(model, margins, [counts[roi.name] for roi in rois])
        data = StageData(
            images=images,
            photos=self._cache(images),
            photo_at=photo_at,
            extent=self.extent,
            rois=margins,
            capacities=capacities,
            regions=self._regions(images, margins, config),
            seed=self.config.seed,
            device=self.device,
        )
        stage = Stage(
            name=name,
            folder=self.folder / name,
            data=data,
            config=config,
            start=model,
            fingerprint=fingerprint(data, config, start_name, order),
            update=self._update,
            preview_seconds=self._preview_seconds,
        )
        return stage.run(self._emit, self._should_stop)

    def _regions(
        self, images: Sequence[PosedImage], rois: Sequence[OrientedBox], config: TrainConfig
    ) -> Regions | None:
        """What the steps of a stage look at that do not look at whole photos."""
        if config.full_every == 1:
            return None
        balance, drawn = config.photo_balance, self._seeing(images)
        return Regions(images, rois, drawn, self.device, balance=balance, check=self._check)

    def _mixed(
        self, images: Sequence[PosedImage], stage: TrainConfig, selected: set[str]
    ) -> tuple[PhotoAt, list[Any]]:
        """The photo of each step of a stage on selected and other photos; what decides it."""
        chosen = [k for k, image in enumerate(images) if image.name in selected]
        drawn = list(range(len(images))) if stage.full_every == 1 else self._seeing(images)
        share, seed = self.config.selected_share, self.config.seed
        photo_at = photo_order.of_boxes(
            len(images), drawn, chosen, share=share, full_every=stage.full_every, seed=seed
        )
        return photo_at, ["mixed", share, chosen, drawn, seed]

    def _seeing(self, images: Sequence[PosedImage]) -> list[int]:
        """Rows of the photos that see a box of the run."""
        seen = {name for roi in self.rois for name in self._seen(roi)}
        return [k for k, image in enumerate(images) if image.name in seen]

    def _images_of(self, roi: OrientedBox) -> list[PosedImage]:
        """The training photos that see the box."""
        seen = set(self._seen(roi))
        return [image for image in self.train_scene.images if image.name in seen]

    def _seen(self, roi: OrientedBox) -> tuple[str, ...]:
        """Their names; looked for once."""
        if roi.name not in self._visible:
            self._visible[roi.name] = visible_images(self.train_scene, roi, self._check)
        return self._visible[roi.name]

    def _points(self) -> tuple[Gaussians, str]:
        """The sparse points as Gaussians, and a name for them."""
        scene = self.train_scene
        digest = hashlib.sha256(scene.points.tobytes() + scene.colors.tobytes()).hexdigest()
        return Gaussians.from_points(scene.points, scene.colors), f"points:{digest}"

    def _start(self, rois: Sequence[OrientedBox]) -> tuple[Gaussians, str]:
        """What a ROI stage begins with, and a name for it."""
        if self.config.roi_init == "points":
            return self._points()
        base = self.scene_stage()
        if self.config.roi_init == "box":
            (roi,) = rois
            return cut(base.gaussians, roi, [roi]), f"box:{base.fingerprint}"
        return base.gaussians, base.fingerprint

    def _cache(self, images: Sequence[PosedImage]) -> PhotoCache:
        """One cache for each list of photos, the last only: stages do not run side by side."""
        key = tuple((image.name, image.camera.width) for image in images)
        if key not in self._photos:
            self._give_photos_back()
            self._photos = {key: PhotoCache(images, self.memory.cache)}
        return self._photos[key]

    def _give_photos_back(self) -> None:
        for cache in self._photos.values():
            cache.close()
        self._photos = {}

    # --- results ---

    def train(self, compare: Sequence[str] = ()) -> list[TrainedModel]:
        """Train the strategy, its result last, and what it is compared with; write the PLYs.

        Args:
            compare: of `config.COMPARISONS`: baselines, and the other strategy in a run of its own
                in a folder inside this one.
        """
        models = [strategies.full_scene(self)] if "full-scene" in compare else []
        models += strategies.full_objects(self) if "full-object" in compare else []
        for strategy in STRATEGIES:
            if strategy in compare and strategy != self.config.strategy:
                self._give_photos_back()  # the memory is for one run's
                other = self._other(strategy)
                models += other.train()
                other._give_photos_back()
        models += strategies.own_models(self)
        self._write_result(models[-1].gaussians)
        return models

    def _other(self, strategy: str) -> Run:
        """The same steps in the other strategy, as its preset has it, in a folder of its own."""
        return Run(
            self.folder / strategy,
            self.scene,
            self.rois,
            in_strategy(self.config, strategy),
            given=self.given,
            update=self._update,
            preview_seconds=self._preview_seconds,
            image_cache=self._image_cache,
            device=self.device,
            emit=self._emit,
            should_stop=self._should_stop,
        )

    def _write_result(self, result: Gaussians) -> None:
        """The result whole, in parts, and the coarse model's Gaussians in each box beside them."""
        coarse = self.scene_stage().gaussians
        result.save_ply(self.folder / "result.ply")
        surroundings(result, self.rois).save_ply(self.folder / "surroundings.ply")
        for roi in self.rois:
            for model, home in ((result, "rois"), (coarse, "coarse")):
                cut(model, roi, self.rois).save_ply(self.folder / home / f"{roi.name}.ply")
