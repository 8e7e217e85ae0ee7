"""One row of one scene and seed: trained or taken from the run folder, measured, recorded."""

from __future__ import annotations

import json
import platform
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from benchmarks.study.rows import BASELINES, FULL_OBJECT, FULL_SCENE, MATCHED, VARIANT, Row
from benchmarks.study.scenes import StudyScene
from roigs_engine.commands.console import Console
from roigs_engine.evaluation.crops import choose_views, write_crops
from roigs_engine.evaluation.evaluate import Evaluation, evaluate
from roigs_engine.evaluation.views import EvaluatedModel
from roigs_engine.formats.names import safe_name
from roigs_engine.kernels import library
from roigs_engine.model.compose import cut
from roigs_engine.model.scene import SfmScene
from roigs_engine.run import stage_configs, strategies
from roigs_engine.run.config import RunConfig
from roigs_engine.run.pipeline import Run
from roigs_engine.run.strategies import BASELINE, TrainedModel
from roigs_engine.training.stage import StageResult


class OnScene(Run):
    """A run whose ROI stages begin from a given Scene-GS."""

    given_scene: StageResult | None = None

    def scene_stage(self) -> StageResult:
        """The given one."""
        return super().scene_stage() if self.given_scene is None else self.given_scene


@dataclass(frozen=True, kw_only=True, eq=False)
class Bench:
    """A scene and seed with everything its rows share.

    Attributes:
        scene, sfm: boxes; photos, cameras and points.
        seed: of everything random.
        preset, factor: settings, and what their steps are multiplied by.
        folder: run folder; stages of all rows are in it or in its `older`.
        pictures: folder of the crops.
        console: takes events, knows whether to stop.
    """

    scene: StudyScene
    sfm: SfmScene
    seed: int
    preset: str
    factor: float
    folder: Path
    pictures: Path
    console: Console

    def request(self, row: Row) -> dict[str, Any]:
        """What decides a row's numbers, as JSON: a record of another request is not the row's."""
        images = self.sfm.images
        request = {
            "kind": row.kind,
            "config": row.config(self.preset, self.factor, self.seed).to_dict(),
            "baseline": asdict(stage_configs.baseline(self._own_config())),
            "rois": [roi.to_dict() for roi in self.scene.rois],
            "photos": len(images),
            "sizes": sorted({f"{i.camera.width}x{i.camera.height}" for i in images}),
        }
        return cast(dict[str, Any], json.loads(json.dumps(request)))

    def measure(self, row: Row, *, keep_models: bool = True) -> dict[str, Any]:
        """Train what is missing and measure it: the record of the row.

        Args:
            row: what to train.
            keep_models: otherwise what only this row needs is deleted, once it is measured.
        """
        own = self._run(self._own_config())
        run = own if row.kind in BASELINES else self._run_of(row)
        made = [strategies.full_scene(own), *self._made(row, run)]
        models = [model.evaluated() for model in made]
        evaluation = evaluate(
            models,
            self.sfm,
            run.test,
            self.scene.rois,
            emit=self.console.emit,
            check=self.console.check,
            object_mask_from=BASELINE,
        )
        record = {
            **self._facts(row, run, made),
            "pictures": self._write_pictures(row, made, models, evaluation),
            "evaluation": evaluation.to_dict(),
        }
        if not keep_models and (row.is_ablation or row.kind == VARIANT):
            for name in _stages(made[1:]).keys() - {*_stages(made[:1]), "scene"}:
                shutil.rmtree(self.folder / name, ignore_errors=True)
        return record

    def _made(self, row: Row, run: Run) -> list[TrainedModel]:
        """The row's models, its result last."""
        if row.kind == FULL_SCENE:
            return []
        if row.kind == FULL_OBJECT:
            return strategies.full_objects(run)
        made = strategies.own_models(run)
        if row.kind == MATCHED:
            ours = made[-1].gaussians
            counts = {roi.name: len(cut(ours, roi, run.rois)) for roi in run.rois}
            return [TrainedModel.of_stage("Matched", run.matched_scene(counts))]
        return made

    def _own_config(self) -> RunConfig:
        row = Row(name="", kind=FULL_SCENE, tables=(), rank=0)
        return row.config(self.preset, self.factor, self.seed)

    def _run_of(self, row: Row) -> Run:
        """The run of the row's settings; an ablation gets the unchanged settings' Scene-GS."""
        given = None
        if row.is_ablation:
            plain = replace(row, changes=()).config(self.preset, self.factor, self.seed)
            given = self._run(plain).scene_stage()
        run = self._run(row.config(self.preset, self.factor, self.seed))
        run.given_scene = given
        return run

    def _run(self, config: RunConfig) -> OnScene:
        return OnScene(
            self.folder,
            self.sfm,
            self.scene.rois,
            config,
            update=True,
            emit=self.console.emit,
            should_stop=self.console.should_stop,
        )

    def _facts(self, row: Row, run: Run, made: Sequence[TrainedModel]) -> dict[str, Any]:
        """Everything of the record but the evaluation."""
        rois = self.scene.rois
        selections = [] if row.kind in BASELINES else [run.selection(roi) for roi in rois]
        return {
            "row": row.name,
            "scene": self.scene.name,
            "seed": self.seed,
            "changes": [list(change) for change in row.changes],
            "request": self.request(row),
            "machine": {**machine(), "date": date.today().isoformat()},
            "steps": run.config.total_steps,
            "stages": {
                name: {"seconds": s.seconds, "cpu_seconds": s.cpu_seconds}
                for name, s in _stages(made).items()
            },
            "models": {
                roi.name: {
                    m.name: [stage.name for stage in m.stages_for(roi.name)]
                    for m in made
                    if m.rois is None or roi.name in m.rois
                }
                for roi in rois
            },
            "selected": {
                chosen.roi: {"candidates": len(chosen.candidates), "chosen": len(chosen.names)}
                for chosen in selections
            },
            "distances": {
                roi.name: {
                    name: float(np.linalg.norm(self.sfm.image(name).centre - roi.centre))
                    for name in run.test
                }
                for roi in rois
            },
        }

    def _write_pictures(
        self,
        row: Row,
        made: Sequence[TrainedModel],
        models: Sequence[EvaluatedModel],
        evaluation: Evaluation,
    ) -> dict[str, dict[str, str]]:
        """Crops of a result beside Full Scene: box -> why this photo -> file below `pictures`."""
        if row.is_ablation or row.kind in BASELINES:
            return {}
        result, folder = made[-1].name, self.pictures / safe_name(row.name)
        write_crops(
            evaluation,
            models,
            self.sfm,
            self.scene.rois,
            folder,
            names=[BASELINE, result],
            check=self.console.check,
        )
        pictures = {}
        for roi in self.scene.rois:
            scores = {score.model: score for score in evaluation.roi(roi.name).rows}
            if not evaluation.roi(roi.name).views:
                continue
            home = folder.relative_to(self.pictures) / "crops" / safe_name(roi.name)
            pictures[roi.name] = {
                label: str(home / f"{safe_name(view)}.png")
                for view, label in choose_views(scores[result], scores[BASELINE]).items()
            }
        return pictures


def _stages(models: Sequence[TrainedModel]) -> dict[str, StageResult]:
    """Every stage behind the models, by name."""
    return {stage.name: stage for model in models for stage in model.all_stages}


def machine() -> dict[str, Any]:
    """What the seconds were measured on."""
    return {
        "cpu": _cpu_name(),
        "cores": library.usable_cores(),
        "threads": library.threads(),
        "kernels": library.isa(),
        "torch": torch.__version__,
    }


def _cpu_name() -> str:
    info = Path("/proc/cpuinfo")
    for line in info.read_text(encoding="utf-8").splitlines() if info.exists() else ():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
