"""Executes a plan: trains or loads each stage once, even if several models need it."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from pathlib import Path

import numpy as np
import torch

from ..context import QUIET, Context
from ..evaluation.views import EvaluatedModel
from ..formats import run_files
from ..formats.files import own_folder, write_json
from ..formats.lock import check_held
from ..formats.stage_list import write_stage_list
from ..model.gaussians import Gaussians
from ..model.operations import crop, merge
from ..model.ownership import joined, owners
from ..model.roi import OrientedBox
from ..model.scene import PosedImage
from ..photos.cache import PhotoCache
from ..training.floaters import shown_by
from ..training.labels import object_owners
from ..training.stage_data import StageData
from .definition import Run
from .plan import CELLS, CROP, MERGE, POINTS, Output, Plan, PlannedModel, Source, Stage
from .stage_folder import StageFolder, StageResult, folder_of


class Executor:
    """Trains the stages of plans in a run's folder, each at most once.

    `preview.ply` is updated every `preview_seconds` of training; 0: there is no preview.
    """

    def __init__(self, run: Run, context: Context = QUIET, *, preview_seconds: float = 0.0) -> None:
        self.run, self.context = run, context
        self._preview_seconds = preview_seconds
        self._memory = run.memory(context)
        self._keeps = run.layout.blocks is None  # models of blocks are too large to keep
        self._named: set[str] = set()
        self._results: dict[str, StageResult] = {}
        self._models: dict[str, Gaussians] = {}
        self._photos: tuple[Hashable, PhotoCache] | None = None

    def execute(self, plan: Plan) -> list[EvaluatedModel]:
        """Train the missing stages and write the outputs; returns the models, the result last.

        Raises:
            Stopped: on request; the same call resumes later.
            RunFolderError: a stage's folder cannot be read or written.
            TrainingError: a stage diverged twice.
        """
        for output in plan.outputs:  # refuse links before hours of training
            for name in (run_files.FINE, run_files.COARSE):
                own_folder(self.run.folder, output.folder, name)
        self.list_stages(plan)
        for folder, selections in plan.selections.items():
            for chosen in selections:
                place = own_folder(self.run.folder, folder, run_files.SELECTION)
                record = chosen.in_units(self.run.frame.scale).to_dict()
                write_json(place / f"{chosen.roi}.json", record)
        for planned in plan.in_training_order:
            self.model(planned)
            for output in plan.outputs:
                if output.model is planned:
                    self._write(output)
        self.list_stages(plan)  # again: equal stages now share a folder
        self.close()
        return [self.model(planned) for planned in plan.models]

    def result(self, stage: Stage) -> StageResult:
        """The stage's result: loaded if finished, otherwise trained now."""
        if stage.name not in self._results:
            folder = self._folder(stage)
            check_held(folder.folder)
            result = folder.finished(self.context) or self._train(stage, folder)
            self._results[stage.name] = result if self._keeps else result.without_model()
        return self._results[stage.name]

    def _train(self, stage: Stage, folder: StageFolder) -> StageResult:
        for needed in stage.start.stages:  # first, before the stage's own photos take memory
            self.result(needed)
        data = self._data(stage)
        config = stage.config.measured(data, self.context)
        return folder.train(lambda: self._start(stage, data), data, config, self.context)

    def _start(self, stage: Stage, data: StageData) -> Gaussians:
        """The Gaussians that a stage's training starts with."""
        start, scene = stage.start, self.run.train_scene
        if start.kind != POINTS or start.rows is not None:
            return self.gaussians(start)
        found = [each.more_points(data, self.context) for each in stage.config.mechanisms]
        more = [points for points in found if points is not None]
        if not more:
            return self.gaussians(start)
        points, colours = zip((scene.points, scene.colors), *more, strict=True)
        return Gaussians.from_points(np.concatenate(points), np.concatenate(colours))

    def gaussians(self, source: Source) -> Gaussians:
        """The Gaussians of a source; trains its input stages if necessary."""
        if source.kind in (CELLS, MERGE, POINTS):
            if source.fingerprint in self._models:
                return self._models[source.fingerprint]
            made = self._made(source)
            if self._keeps:
                self._models[source.fingerprint] = made
            return made
        if source.base is None:
            return self._of(source.inputs[0])
        model = self.gaussians(source.base)
        if source.kind == CROP:
            return crop(model, source.rois[0], source.rois)
        on_device = model.to(torch.device(self.context.device))
        return model.rows(shown_by(on_device, source.images, self.context).to(model.means.device))

    def model(self, planned: PlannedModel) -> EvaluatedModel:
        """The planned model, trained, with the time of all its stages."""
        results = [self.result(stage) for stage in planned.all_stages]
        return EvaluatedModel(
            name=planned.name,
            gaussians=self.gaussians(planned.source),
            seconds=sum(result.record.seconds for result in results),
            rois=planned.rois,
            stages={each.name.rpartition("/")[2]: each.record.seconds for each in results},
        )

    def status(self, stage: Stage) -> StageResult | int:
        """The progress of a stage: see `StageFolder.peek`."""
        return self._folder(stage).peek()

    def list_stages(self, plan: Plan) -> None:
        """Write the list of the plan's stage folders; RunFolderError if that fails."""
        folders = {stage.name: self._place(stage) for stage in plan.stages}
        write_stage_list(self.run.folder, folders)

    def close(self) -> None:
        """Drop the decoded photos."""
        if self._photos:
            self._photos[1].close()
        self._photos = None

    def _place(self, stage: Stage) -> Path:
        return folder_of(self.run.folder, stage.name, stage.fingerprint)

    def _folder(self, stage: Stage) -> StageFolder:
        return StageFolder(
            name=stage.name,
            folder=self._place(stage),
            fingerprint=stage.fingerprint,
            frame=self.run.frame,
            preview=self.run.folder / run_files.PREVIEW,
            preview_seconds=self._preview_seconds,
            named=self._named,
        )

    def _data(self, stage: Stage) -> StageData:
        device = torch.device(self.context.device)

        def labelled() -> tuple[Gaussians, torch.Tensor]:
            start = self.gaussians(stage.start)
            return start, self._owners(start, stage.rois)

        return StageData(
            images=stage.images,
            photos=self._cache(stage.images),
            photo_at=stage.order.photo_at(),
            extent=stage.extent,
            rois=stage.rois,
            labelled=labelled,
            points=self.run.train_scene.points,
            seed=stage.seed,
            device=device,
            card_photos=self._memory.card.photos if self._memory.card else None,
        )

    def _of(self, stage: Stage) -> Gaussians:
        result = self.result(stage)
        return result.gaussians if self._keeps else result.without_model().gaussians

    def _made(self, source: Source) -> Gaussians:
        """The sparse points as Gaussians, or the results of several stages as one model."""
        if source.kind == POINTS:
            scene, rows = self.run.train_scene, source.rows
            chosen = slice(None) if rows is None else rows
            return Gaussians.from_points(scene.points[chosen], scene.colors[chosen])
        models = (self._of(stage) for stage in source.inputs)
        if source.partition is not None:
            return joined(models, source.partition)
        assert source.base is not None
        pairs = list(zip(source.rois, models, strict=True))
        return merge(self.gaussians(source.base), pairs, self._owners)

    def _owners(self, model: Gaussians, rois: Sequence[OrientedBox]) -> torch.Tensor:
        """The box that owns each Gaussian; with masks of objects, boxes own only their object."""
        images = self.run.train_scene.images
        if not any(image.objects for image in images):
            return owners(model, rois)
        on_device = model.to(torch.device(self.context.device))
        return object_owners(on_device, rois, images, self.context).to(model.means.device)

    def _cache(self, images: Sequence[PosedImage]) -> PhotoCache:
        """The cache of these photos; drops the previous one, as only one stage runs at a time."""
        key = tuple((image.name, image.camera.width) for image in images)
        if self._photos is None or self._photos[0] != key:
            self.close()
            self._photos = key, PhotoCache(images, self._memory.cache)
        return self._photos[1]

    def _write(self, output: Output) -> None:
        """Write the whole result, its parts, and the Scene-GS's Gaussians in each box.

        The parts are the Gaussians that each box owns (see `_owners`), and the rest.
        """
        folder = own_folder(self.run.folder, output.folder)
        rois, frame = self.run.rois, self.run.frame
        result = self.gaussians(output.model.source)
        coarse = self.gaussians(output.coarse)
        check_held(folder)
        result.save_ply(folder / run_files.RESULT, frame)
        owner, coarse_owner = self._owners(result, rois), self._owners(coarse, rois)
        result.rows(owner == -1).save_ply(folder / run_files.BACKGROUND, frame)
        for index, roi in enumerate(rois):
            part = result.rows(owner == index)
            part.save_ply(own_folder(folder, run_files.FINE) / f"{roi.name}.ply", frame)
            if not len(part):
                self._warn_of_nothing(roi)
            part = coarse.rows(coarse_owner == index)
            part.save_ply(own_folder(folder, run_files.COARSE) / f"{roi.name}.ply", frame)

    def _warn_of_nothing(self, roi: OrientedBox) -> None:
        text = f"The result has no Gaussian in box '{roi.name}'. Are the cameras right?"
        if any(roi.name in image.objects for image in self.run.train_scene.images):
            what = "the masks select no Gaussian of the result. Is white the object?"
            text = f"Box '{roi.name}': {what}"
        self.context.warn(text)
