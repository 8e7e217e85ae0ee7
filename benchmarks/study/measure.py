"""One row of one scene and seed: trained or taken from the run folder, measured, recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import date
from pathlib import Path
from shutil import rmtree
from typing import Any, cast

import numpy as np
import torch

from benchmarks.study import rows
from benchmarks.study.baselines import matched, one_stage, one_stage_config
from benchmarks.study.rows import BASELINES, EQUAL_TIME, FULL_SCENE, TUNED_BASELINES, VARIANT, Row
from benchmarks.study.scenes import StudyScene
from roigs_engine.context import QUIET, Context
from roigs_engine.evaluation.crops import choose_views, write_crops
from roigs_engine.evaluation.evaluate import evaluate
from roigs_engine.evaluation.scores import FULL_SCENE as BASELINE
from roigs_engine.evaluation.scores import Evaluation
from roigs_engine.evaluation.views import EvaluatedModel
from roigs_engine.formats import run_files
from roigs_engine.formats.names import safe_name
from roigs_engine.kernels import library
from roigs_engine.machine import processor_name, usable_cores
from roigs_engine.model.ownership import count_owned
from roigs_engine.model.scene import SfmScene
from roigs_engine.requests.choices import MAX_FACTOR, TEST
from roigs_engine.run import stage_configs, strategies
from roigs_engine.run.config import RunConfig
from roigs_engine.run.definition import Run, define_run, inputs_record
from roigs_engine.run.executor import Executor
from roigs_engine.run.folder import open_folder
from roigs_engine.run.manifest import from_json
from roigs_engine.run.plan import Plan
from roigs_engine.run.stages import PhotoSets, scene_stage
from roigs_engine.training.config import with_steps
from roigs_engine.training.mechanisms.density_control import DensityControl

EQUAL_TIME_FOLDER = run_files.COMPARED + "equal-time"


@dataclass(frozen=True, kw_only=True, eq=False)
class Bench:
    """A scene and seed with everything its rows share.

    Attributes:
        scene, sfm: boxes; photos, cameras and points.
        seed: of everything random.
        preset, factor: settings, and what their steps are multiplied by.
        evaluate_on: `test` or `validation` photos.
        folder: run folder of all rows; each row has its stages there.
        pictures: folder of the crops.
        context: of the work.
    """

    scene: StudyScene
    sfm: SfmScene
    seed: int
    preset: str
    factor: float
    folder: Path
    pictures: Path
    evaluate_on: str = TEST
    context: Context = QUIET

    def manifest(self, row: Row) -> dict[str, Any]:
        """Everything that decides a row's numbers, as JSON. Records of other manifests are old."""
        inputs = inputs_record(self.sfm, self.scene.rois)
        baseline = asdict(stage_configs.baseline(self._own_config()))
        config = self._config(row).to_dict()
        manifest = {"kind": row.kind, "baseline": baseline, "config": config, **inputs}
        if row.kind in (*TUNED_BASELINES, EQUAL_TIME):
            own = self._own_config()
            tuned = one_stage_config if row.kind == rows.ONE_STAGE else stage_configs.tuned_baseline
            manifest["tuned"] = asdict(tuned(own))
        return cast(dict[str, Any], from_json(manifest))

    def measure(self, row: Row, *, keep_models: bool = True) -> dict[str, Any]:
        """Train what is missing and measure it: the record of the row.

        Args:
            row: what to train.
            keep_models: otherwise what only this row needs is deleted, once it is measured.
        """
        run, plan = self._planned(row)
        open_folder(run, self.context, update=True)
        executor = Executor(run, self.context)
        models = executor.execute(plan)
        evaluation = evaluate(
            models,
            self.sfm,
            run.measured,
            self.scene.rois,
            context=self.context,
            baseline=BASELINE,
            object_mask_from=BASELINE,
            photos=self.evaluate_on,
        )
        record = {
            **self._facts(row, run, plan, executor),
            "pictures": self._write_pictures(row, models, evaluation),
            "evaluation": evaluation.to_dict(),
        }
        if not keep_models and (row.is_ablation or row.kind == VARIANT):
            own, full_scene = (
                {stage.name: stage for model in part for stage in model.all_stages}
                for part in (plan.models[1:], plan.models[:1])
            )
            for name in own.keys() - {*full_scene, "scene"}:
                rmtree(executor.result(own[name]).model_path.parent, ignore_errors=True)
        return record

    def _planned(self, row: Row) -> tuple[Run, Plan]:
        """The row's run, and the plan of Full Scene and the row's models, its result last.

        An ablation starts from the Scene-GS of the unchanged settings.
        """
        own = define_run(
            self.folder, self.sfm, self.scene.rois, self._own_config(), context=self.context
        )
        photos = PhotoSets(own, self.context)
        plan = strategies.full_scene(photos)
        if row.kind in BASELINES:
            return own, plan + self._baseline(row.kind, photos)
        run, coarse = replace(own, config=self._config(row)), None
        if row.kind == EQUAL_TIME:
            longer = replace(run, config=longer_box_stage(run.config, self._time_factor(own, run)))
            coarse = scene_stage(PhotoSets(run, self.context))
            photos = PhotoSets(longer, self.context, folder=EQUAL_TIME_FOLDER)
            made = strategies.strategy(photos, coarse=coarse)
            model = replace(made.models[-1], name="Joint, equal time")
            return longer, plan + Plan(models=(model,), selections=made.selections)
        if row.is_ablation:
            unchanged = replace(own, config=self._config(replace(row, changes=())))
            coarse = scene_stage(PhotoSets(unchanged, self.context))
        made = strategies.strategy(PhotoSets(run, self.context), coarse=coarse)
        return run, plan + replace(made, outputs=())

    def _time_factor(self, own: Run, joint: Run) -> float:
        """Factor on our box stage's steps that takes the tuned Full Scene's CPU time.

        Trains both, unless they are finished. Their seconds are on disk, so that the factor is the
        same whenever the row is resumed.
        """
        tuned = strategies.full_scene_tuned(PhotoSets(own, self.context))
        ours = strategies.strategy(PhotoSets(joint, self.context))
        open_folder(joint, self.context, update=True)
        executor = Executor(joint, self.context)
        plan = tuned + replace(ours, outputs=())
        executor.execute(plan)
        theirs, boxes = (
            {s.name: executor.result(s).record.cpu_seconds for s in plan.models[row].all_stages}
            for row in (0, -1)
        )
        scene = boxes.pop(run_files.SCENE_STAGE)
        return equal_time_factor(sum(theirs.values()) - scene, sum(boxes.values()))

    def _config(self, row: Row) -> RunConfig:
        config = row.config(self.preset, self.factor, self.seed)
        return replace(config, evaluate_on=self.evaluate_on)

    def _own_config(self) -> RunConfig:
        """The preset's."""
        return self._config(Row(name="", kind=FULL_SCENE, tables=(), rank=0))

    def _baseline(self, kind: str, photos: PhotoSets) -> Plan:
        """The baseline of that kind, which stands beside Full Scene."""
        match kind:
            case rows.FULL_OBJECT:
                return strategies.full_objects(photos)
            case rows.TUNED:
                return strategies.full_scene_tuned(photos)
            case rows.OBJECT_TUNED:
                return strategies.full_objects_tuned(photos)
            case rows.ONE_STAGE:
                return one_stage(photos)
            case rows.MATCHED | rows.MATCHED_TUNED:
                ours = strategies.strategy(photos).models[-1]
                open_folder(photos.run, self.context, update=True)
                model = Executor(photos.run, self.context).model(ours).gaussians
                budgets = tuple(count_owned(model, photos.run.rois))
                return matched(photos, budgets, tuned=kind == rows.MATCHED_TUNED)
        return Plan()

    def _facts(self, row: Row, run: Run, plan: Plan, executor: Executor) -> dict[str, Any]:
        """Everything of the record but the evaluation."""
        rois = self.scene.rois
        return {
            "row": row.name,
            "scene": self.scene.name,
            "seed": self.seed,
            "changes": [list(change) for change in row.changes],
            "manifest": self.manifest(row),
            "machine": {**machine(), "date": date.today().isoformat()},
            "steps": run.config.total_steps,
            "steps_factor": run.config.total_steps / self._own_config().total_steps,
            "stages": {
                stage.name: {"seconds": result.seconds, "cpu_seconds": result.cpu_seconds}
                for model in plan.models
                for stage in model.all_stages
                for result in (executor.result(stage).record,)
            },
            "models": {
                roi.name: {
                    m.name: [stage.name for stage in (*m.stages, *m.by_roi.get(roi.name, ()))]
                    for m in plan.models
                    if m.rois is None or roi.name in m.rois
                }
                for roi in rois
            },
            "selected": {
                chosen.roi: {"candidates": len(chosen.candidates), "chosen": len(chosen.names)}
                for selections in plan.selections.values()
                for chosen in selections
            },
            "distances": {
                roi.name: {
                    name: float(np.linalg.norm(self.sfm.image(name).centre - roi.centre))
                    for name in run.measured
                }
                for roi in rois
            },
        }

    def _write_pictures(
        self,
        row: Row,
        models: Sequence[EvaluatedModel],
        evaluation: Evaluation,
    ) -> dict[str, dict[str, str]]:
        """Crops of a result beside Full Scene: box -> why this photo -> file below `pictures`."""
        if row.is_ablation or row.kind in BASELINES:
            return {}
        result, folder = models[-1].name, self.pictures / safe_name(row.name)
        write_crops(
            evaluation,
            models,
            self.sfm,
            self.scene.rois,
            folder,
            names=[BASELINE, result],
            context=self.context,
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


def equal_time_factor(theirs: float, ours: float) -> float:
    """`theirs` / `ours`, both in seconds, to two digits."""
    factor = theirs / max(ours, 1e-9)
    return min(max(float(f"{factor:.2g}"), 0.01), MAX_FACTOR)


def longer_box_stage(config: RunConfig, factor: float) -> RunConfig:
    """The config with the box stage's steps multiplied, not those that densify.

    So it learns for longer, with as many Gaussians.
    """
    roi = with_steps(config.roi, max(1, round(factor * config.roi.steps)))
    if (density := roi.get(DensityControl)) and (own := config.roi.get(DensityControl)):
        roi = roi.using(replace(density, until=min(density.until, own.until)))
    return replace(config, roi=roi)


def machine() -> dict[str, Any]:
    """The machine of the measurement."""
    return {
        "cpu": processor_name(),
        "cores": usable_cores(),
        "threads": library.threads(),
        "kernels": library.isa(),
        "torch": torch.__version__,
    }
