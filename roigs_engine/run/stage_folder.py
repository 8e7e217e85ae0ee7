"""The folder of a stage: trains the stage there, resumes it, or loads its finished result.

The folder has `checkpoint.bin` while the stage trains, and `model.ply` and `stage.json` when it is
finished. Both states carry a fingerprint: a hash of everything that decides the stage's result.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path

from ..context import QUIET, Context
from ..cuda.device import CPU
from ..errors import RunFolderError, Stopped, TrainingError
from ..formats import run_files
from ..formats.events import Preview, StageStarted
from ..formats.files import read_json, write_json
from ..formats.text import counted
from ..model.gaussians import Gaussians
from ..training.callbacks import PeriodicCallback
from ..training.checkpoint import (
    checkpoint_exists,
    checkpoint_fingerprint,
    load_checkpoint,
    remove_checkpoint,
    save_checkpoint,
)
from ..training.config import TrainConfig
from ..training.state import check_state
from ..training.trainer import StageData, Trainer
from .archive import archive, restore

CHECKPOINT_SECONDS = 60.0


@dataclass(frozen=True, kw_only=True, eq=False)
class StageResult:
    """A finished stage.

    Attributes:
        name: the stage's name.
        model_path: the trained model's PLY.
        count: number of its Gaussians.
        seconds: training time without checkpoints and evaluation.
        cpu_seconds: the same as CPU time of all threads of this process. Compare this one on a
            machine that is busy with other programs.
        trained: the model, if this process trained it.
    """

    name: str
    model_path: Path
    count: int
    seconds: float
    cpu_seconds: float
    trained: Gaussians | None = field(default=None, repr=False)

    @cached_property
    def gaussians(self) -> Gaussians:
        """The trained model; loaded from its file on first use."""
        return self.trained or Gaussians.load_ply(self.model_path)


@dataclass(frozen=True, kw_only=True, eq=False)
class StageFolder:
    """The folder that a stage is trained in.

    Attributes:
        name: the stage's name, shown to the user.
        folder: the stage's folder.
        fingerprint: of the stage.
        update: archive a stage with another fingerprint instead of raising an error.
        preview: file for the preview of the current Gaussians; None: no preview.
        preview_seconds: seconds of training between two previews.
    """

    name: str
    folder: Path
    fingerprint: str
    update: bool = False
    preview: Path | None = None
    preview_seconds: float = 0.0

    @property
    def _checkpoint(self) -> Path:
        return self.folder / run_files.CHECKPOINT

    @property
    def _record(self) -> Path:
        return self.folder / run_files.STAGE

    def peek(self) -> StageResult | None:
        """The stage's result if it is finished, or None; changes nothing."""
        with suppress(RunFolderError):
            return self._finished() if (self.folder / run_files.MODEL).exists() else None
        return None

    def finished(self, context: Context = QUIET) -> StageResult | None:
        """The stage's result if it is finished, or None; `update` archives another stage first.

        Raises:
            RunFolderError: the folder has other settings, or is damaged.
        """
        if self.update:
            self._make_room(context)
        result = self._finished()
        if result is not None:
            remove_checkpoint(self._checkpoint)  # left if the engine was killed at the very end
            context.info(f"{self.name}: already finished, {counted(result.count, 'Gaussian')}.")
        return result

    def _finished(self) -> StageResult | None:
        if not self._record.exists():
            return None
        record = read_json(self._record)
        if not isinstance(record, dict) or record.get("fingerprint") != self.fingerprint:
            raise RunFolderError(
                f"{self.folder} was trained with other settings or photos.",
                "Add --update to archive it and train again, or choose another run folder"
                " (--run-dir).",
            )
        try:
            return StageResult(
                name=self.name,
                model_path=self.folder / run_files.MODEL,
                count=int(record["gaussians"]),
                seconds=float(record["seconds"]),
                cpu_seconds=float(record["cpu_seconds"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise RunFolderError(
                f"{self._record} is damaged.", f"Delete {self.folder} to train the stage again."
            ) from error

    def train(
        self,
        start: Callable[[], Gaussians],
        data: StageData,
        config: TrainConfig,
        context: Context,
    ) -> StageResult:
        """Train the stage to its end, from its last checkpoint if there is one.

        Args:
            start: returns the Gaussians to start from.
            data, config: see `Trainer`.
            context: of the run.

        Raises:
            Stopped: on request; a checkpoint was written.
            RunFolderError: the checkpoint has other settings, or is damaged.
            TrainingError: training diverged twice.
        """
        context.emit(StageStarted(stage=self.name, total=config.steps))
        try:
            trainer = self._trained(start, data, config, context)
        except TrainingError as error:
            context.warn(f"{self.name}: {error.message} Trying again from the last checkpoint.")
            trainer = self._trained(start, data, config, context)
        for text in trainer.health.outliers():
            context.warn(f"{self.name}: {text}")
        return self._finish(trainer)

    def _trained(
        self,
        start: Callable[[], Gaussians],
        data: StageData,
        config: TrainConfig,
        context: Context,
    ) -> Trainer:
        """A trainer at its last step; `_save` never writes a checkpoint with NaN or Inf."""
        trainer = self._resumed(start, data, config, context)
        callbacks = [PeriodicCallback(CHECKPOINT_SECONDS, lambda: self._save(trainer))]
        if self.preview is not None:
            callbacks.append(
                PeriodicCallback(
                    self.preview_seconds, lambda: self._write_preview(trainer, context)
                )
            )
        if not trainer.run(context, stage=self.name, callbacks=callbacks):
            self._save(trainer)
            raise Stopped(self.name)
        trainer.check()
        return trainer

    def _resumed(
        self,
        start: Callable[[], Gaussians],
        data: StageData,
        config: TrainConfig,
        context: Context,
    ) -> Trainer:
        """A trainer at step 0, or at the step of the checkpoint."""
        if not checkpoint_exists(self._checkpoint):
            return Trainer(start(), data, config)
        check = partial(check_state, config=config)
        state = load_checkpoint(self._checkpoint, self.fingerprint, context, check)
        trainer = Trainer(Gaussians(**state["parameters"]), data, config)
        trainer.load_state_dict(state)
        context.info(f"{self.name}: resumes at step {trainer.step}.")
        return trainer

    def _save(self, trainer: Trainer) -> None:
        trainer.check()
        save_checkpoint(self._checkpoint, trainer.state_dict(), self.fingerprint)

    def _write_preview(self, trainer: Trainer, context: Context) -> None:
        """Write the preview; skip it if the file is in use (on Windows, while it is read)."""
        assert self.preview is not None
        with suppress(RunFolderError):
            trainer.gaussians.save_ply(self.preview)
            context.emit(Preview(path=str(self.preview)))

    def _make_room(self, context: Context) -> None:
        """Archive a stage with another fingerprint; restore this one from the archive."""
        present = self._present_fingerprint()
        if present == self.fingerprint:
            return
        if present is not None:
            archive(self.folder, present)
            context.info(f"{self.name}: archived the stage of other settings or photos.")
        restore(self.folder, self.fingerprint)

    def _present_fingerprint(self) -> str | None:
        """The fingerprint of the stage in the folder, finished or not; None: no stage."""
        if self._record.exists():
            record = read_json(self._record)
            return str(record.get("fingerprint")) if isinstance(record, dict) else "damaged"
        if checkpoint_exists(self._checkpoint):
            return checkpoint_fingerprint(self._checkpoint)
        return None

    def _finish(self, trainer: Trainer) -> StageResult:
        model = trainer.gaussians.detached().to(CPU)
        path = self.folder / run_files.MODEL
        model.save_ply(path)
        record = {
            "fingerprint": self.fingerprint,
            "seconds": trainer.seconds,
            "cpu_seconds": trainer.cpu_seconds,
            "steps": trainer.step,
            "gaussians": len(model),
            "device": trainer.data.device.type,
        }
        write_json(self._record, record)
        remove_checkpoint(self._checkpoint)
        return StageResult(
            name=self.name,
            model_path=path,
            count=len(model),
            seconds=trainer.seconds,
            cpu_seconds=trainer.cpu_seconds,
            trained=model,
        )
