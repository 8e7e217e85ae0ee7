"""Whole runs on a small synthetic scene, for the tests of several rooms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from roigs_engine.context import QUIET, Context
from roigs_engine.evaluation.views import EvaluatedModel
from roigs_engine.formats.stage_list import read_stage_list
from roigs_engine.model.roi import OrientedBox
from roigs_engine.model.scene import SfmScene
from roigs_engine.run.config import RunConfig
from roigs_engine.run.definition import Run, define_run
from roigs_engine.run.folder import open_folder, train_opened
from roigs_engine.run.presets import preset
from roigs_engine.training import checkpoint
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms.density_control import DensityControl
from tests.engine.settings import adjusted

Manual = Mapping[str, Sequence[str]]


def tiny(strategy: str, **changes: object) -> RunConfig:
    """A preset of so few steps that a run takes a second."""
    config = preset("paper" if strategy == "independent" else "draft")
    quick = {"every": 4, "grad_threshold": 1e-5, "reset_every": 0}
    scene_stage = TrainConfig(
        steps=12,
        made_for=config.roi.made_for,
        mechanisms=(DensityControl(start=3, until=9, **quick),),
    )
    roi_stage = replace(adjusted(config.roi, DensityControl, until=12, **quick), steps=18)
    selection = replace(config.selection, count=5)
    config = replace(config, scene=scene_stage, roi=roi_stage, selection=selection, test_every=4)
    return replace(config, **changes)


def plys(folder: Path) -> dict[str, bytes]:
    """Every PLY below a folder; of those in `earlier` and in damaged stages, none."""
    found = (p.relative_to(folder) for p in sorted(folder.rglob("*.ply")))
    return {
        str(p): (folder / p).read_bytes()
        for p in found
        if p.parts[0] != "earlier" and "-damaged" not in p.parts[-2:][0]
    }


def opened(
    folder: Path,
    scene: SfmScene,
    rois: Sequence[OrientedBox],
    config: RunConfig,
    *,
    manual: Manual | None = None,
    update: bool = False,
    context: Context = QUIET,
) -> Run:
    """A run whose folder is open."""
    run = define_run(folder, scene, rois, config, manual=manual, context=context)
    open_folder(run, context, update=update)
    return run


def train_run(
    run: Run,
    compare: Sequence[str] = (),
    context: Context = QUIET,
    *,
    update: bool = False,
    preview_seconds: float = 0.0,
) -> list[EvaluatedModel]:
    """A run's models, trained in its folder."""
    open_folder(run, context, update=update)
    return train_opened(run, compare, context, preview_seconds=preview_seconds)


def train(
    folder: Path,
    scene: SfmScene,
    rois: Sequence[OrientedBox],
    config: RunConfig,
    compare: Sequence[str] = (),
    *,
    manual: Manual | None = None,
    update: bool = False,
    preview_seconds: float = 0.0,
    context: Context = QUIET,
) -> list[EvaluatedModel]:
    """A run from its inputs to its models."""
    run = define_run(folder, scene, rois, config, manual=manual, context=context)
    return train_run(run, compare, context, update=update, preview_seconds=preview_seconds)


SECOND = OrientedBox.between("second", [-0.2, -0.2, -0.2], [0.5, 0.5, 0.5])


def production(strategy: str = "joint", **changes: object) -> RunConfig:
    return tiny(strategy, test_every=0, kept_share=1.0, **changes)


def checkpoint_step(path: Path) -> int:
    """The step of a checkpoint, whatever it is of."""
    with path.open("rb") as file:
        return int(checkpoint._header(file)["state"]["step"])


def stage_of(run: Path, name: str) -> Path:
    """The folder of a stage of a run's present settings."""
    return read_stage_list(run)[name]


def finished(run: Path) -> set[str]:
    """Names of the finished stages of a run's present settings."""
    stages = read_stage_list(run)
    return {name for name, folder in stages.items() if (folder / "stage.json").exists()}
