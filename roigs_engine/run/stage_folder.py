"""The folder of a stage: trains the stage there, resumes it, or loads its finished result.

The folder has `checkpoint.bin` while the stage trains, and `model.ply` and `stage.json` when it is
finished. Both states carry a fingerprint: a hash of everything that decides the stage's result. A
finished stage is verified by its checksums when its result is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

from ..context import QUIET, Context
from ..cuda.device import CPU
from ..errors import GpuMemoryError, RunFolderError, Stopped, TrainingError
from ..formats import run_files
from ..formats.events import Preview, StageStarted
from ..formats.files import is_link, matching, own_folder, sha256
from ..formats.lock import check_held
from ..formats.text import counted
from ..model.gaussians import Gaussians
from ..model.local_frame import LocalFrame
from ..training.checkpoint import (
    check_state,
    checkpoint_exists,
    checkpoint_step,
    load_checkpoint,
    remove_checkpoint,
    save_checkpoint,
)
from ..training.config import TrainConfig
from ..training.loop import PeriodicCallback
from ..training.stage_data import StageData
from ..training.trainer import Trainer
from .earlier import move_damaged
from .stage_record import DamagedError, StageRecord, check_model, read_record, write_record

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
        frame: of the model; the file is in the world's.
        trained: the model, if this process trained it.
    """

    name: str
    model_path: Path
    count: int
    seconds: float
    cpu_seconds: float
    frame: LocalFrame
    trained: Gaussians | None = field(default=None, repr=False)

    @cached_property
    def gaussians(self) -> Gaussians:
        """The trained model; loaded from its file on first use."""
        return self.trained or Gaussians.load_ply(self.model_path, self.frame)

    def without_model(self) -> StageResult:
        """The same without the model in memory."""
        return replace(self, trained=None)


@dataclass(frozen=True, kw_only=True)
class StageStatus:
    """How far a stage is.

    Attributes:
        result: its result; None: it is not finished.
        step: of its checkpoint, from which it would be resumed; 0: there is none.
    """

    result: StageResult | None = None
    step: int = 0


def folder_of(run: Path, name: str, fingerprint: str) -> Path:
    """Where a stage is in a run folder: in `stages/NAME-FINGERPRINT`, which need not exist.

    If that does not exist, a finished stage of the same fingerprint serves, whatever its name: the
    box was renamed, or two stages of a plan are the same.

    Raises:
        RunFolderError: the folder is a link, or no folder.
    """
    stages, mark = own_folder(run, run_files.STAGES), fingerprint[:8]
    own = own_folder(stages, f"{name.replace('/', '-')}-{mark}")
    if own.exists():
        return own
    for twin in matching(stages, f"*-{mark}"):
        with suppress(RunFolderError, DamagedError):
            record = read_record(twin / run_files.STAGE)
            if record and record.fingerprint == fingerprint and not is_link(twin):
                return twin
    return own


@dataclass(frozen=True, kw_only=True, eq=False)
class StageFolder:
    """The folder that a stage is trained in.

    Attributes:
        name: the stage's name, shown to the user.
        folder: the stage's folder (`folder_of`).
        fingerprint: of the stage.
        frame: that the stage is trained in; its PLYs are in the world's.
        preview: file for the preview of the current Gaussians; None: no preview.
        preview_seconds: seconds of training between two previews.
        named: photos that no warning names any more, as one has; gets those of this stage.
    """

    name: str
    folder: Path
    fingerprint: str
    frame: LocalFrame = field(default_factory=LocalFrame.world)
    preview: Path | None = None
    preview_seconds: float = 0.0
    named: set[str] = field(default_factory=set)

    @property
    def _checkpoint(self) -> Path:
        return self.folder / run_files.CHECKPOINT

    @property
    def _record(self) -> Path:
        return self.folder / run_files.STAGE

    def peek(self) -> StageStatus:
        """How far the stage is; changes nothing."""
        with suppress(RunFolderError, DamagedError):
            record = read_record(self._record)
            if record is not None:
                return StageStatus(result=self._verified(record))
        return StageStatus(step=checkpoint_step(self._checkpoint, self.fingerprint))

    def finished(self, context: Context = QUIET) -> StageResult | None:
        """The stage's result if it is finished, or None.

        A result that is damaged is moved aside, with a warning, and counts as missing.

        Raises:
            RunFolderError: the folder cannot be read.
        """
        try:
            record = read_record(self._record)
            if record is None:
                return None
            result = self._verified(record)
        except DamagedError as error:
            self._move_damaged(error, context)
            return None
        remove_checkpoint(self._checkpoint)  # left if the engine was killed at the very end
        gaussians = counted(result.count, "Gaussian")
        context.info(f"{self.name}: finished in an earlier training; its {gaussians} are used.")
        return result

    def _move_damaged(self, error: DamagedError, context: Context) -> None:
        place = move_damaged(self.folder, (run_files.STAGE, run_files.MODEL))
        again = "resumed from its checkpoint" if checkpoint_exists(self._checkpoint) else "repeated"
        context.warn(
            f"{self.name}: {error}. The stage is {again}; its damaged files are in {place}."
        )

    def _verified(self, record: StageRecord) -> StageResult:
        """The result of a finished stage, whose model is as it was trained.

        Raises:
            RunFolderError: the model cannot be read.
            DamagedError: the model is damaged or missing, or the record is of another stage.
        """
        if record.fingerprint != self.fingerprint:
            raise DamagedError(f"{self._record} is of another stage")
        path = self.folder / run_files.MODEL
        check_model(path, record)
        return StageResult(
            name=self.name,
            model_path=path,
            count=record.gaussians,
            seconds=record.seconds,
            cpu_seconds=record.cpu_seconds,
            frame=self.frame,
        )

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
            GpuMemoryError: the GPU memory is full; a checkpoint was written if it fits.
        """
        context.emit(StageStarted(stage=self.name, total=config.steps))
        try:
            trainer = self._trained(start, data, config, context)
        except TrainingError as error:
            again = "last checkpoint" if checkpoint_exists(self._checkpoint) else "start"
            context.warn(f"{self.name}: {error.message} Trying again from the {again}.")
            trainer = self._trained(start, data, config, context)
        if text := trainer.health.outliers(self.named):
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
        try:
            is_done = trainer.run(context, stage=self.name, callbacks=callbacks)
        except GpuMemoryError:
            if trainer.is_between_steps:
                with suppress(GpuMemoryError, RuntimeError):  # out of memory again, or a broken GPU
                    self._save(trainer)
            raise
        if not is_done:
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
            return Trainer(start(), data, config, context)
        check = partial(check_state, config=config)
        state = load_checkpoint(self._checkpoint, self.fingerprint, context, check)
        trainer = Trainer(Gaussians(**state["parameters"]), data, config, context)
        trainer.load_state_dict(state)
        how = f"resumes at step {trainer.step}" if trainer.step else "starts at step 0"
        context.info(f"{self.name}: {how}.")
        return trainer

    def _save(self, trainer: Trainer) -> None:
        trainer.check()
        check_held(self.folder)
        save_checkpoint(self._checkpoint, trainer.state_dict(), self.fingerprint)

    def _write_preview(self, trainer: Trainer, context: Context) -> None:
        """Write the preview; skip it if the file is in use (on Windows, while it is read)."""
        assert self.preview is not None
        with suppress(RunFolderError):
            check_held(self.folder)
            trainer.gaussians.save_ply(self.preview, self.frame)
            context.emit(Preview(path=str(self.preview)))

    def _finish(self, trainer: Trainer) -> StageResult:
        model = trainer.gaussians.detached().to(CPU)
        path = self.folder / run_files.MODEL
        check_held(self.folder)
        model.save_ply(path, self.frame)
        record = StageRecord(
            fingerprint=self.fingerprint,
            seconds=trainer.seconds,
            cpu_seconds=trainer.cpu_seconds,
            steps=trainer.step,
            gaussians=len(model),
            device=trainer.data.device.type,
            model_sha256=sha256(path),
        )
        write_record(self._record, record)
        remove_checkpoint(self._checkpoint)
        return StageResult(
            name=self.name,
            model_path=path,
            count=len(model),
            seconds=trainer.seconds,
            cpu_seconds=trainer.cpu_seconds,
            frame=self.frame,
            # The file rounds in another frame; a resumed run, which reads it, must go on the same.
            trained=model if self.frame.is_world else None,
        )
