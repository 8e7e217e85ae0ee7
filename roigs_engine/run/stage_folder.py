"""The folder of a stage: trains the stage, resumes it, or loads its finished result.

The folder has `checkpoint.bin` while the stage trains, and `model.ply` and `stage.json` when it is
finished. Both states have a fingerprint: a hash of everything that decides the stage's result. The
checksums of a finished stage are verified when its result is used.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

from ..context import QUIET, Context
from ..cuda.device import CPU
from ..errors import KernelError, RunFolderError, Stopped, TrainingError
from ..formats import run_files
from ..formats.events import Preview, StageStarted
from ..formats.files import (
    UNREADABLE,
    is_link,
    matching,
    own_folder,
    read_bytes,
    sha256,
    write_json,
)
from ..formats.lock import check_held
from ..formats.text import counted, json_digest
from ..gpu.program import drawing
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

CHECKPOINT_SECONDS = 60.0
MOST = 1 << 40  # limit for steps, Gaussians and seconds
CHECKSUM = "checksum"


class DamagedError(Exception):
    """A finished stage cannot be used; the text says why."""


@dataclass(frozen=True, kw_only=True)
class StageRecord:
    """`stage.json` without its checksum."""

    fingerprint: str
    seconds: float  # of training, without checkpoints and evaluation
    cpu_seconds: float  # the same in CPU time of all threads, for comparisons on a busy machine
    steps: int
    gaussians: int  # number of Gaussians
    device: str  # the type of device that trained it: `cpu`, `cuda`, `gpu`
    model_sha256: str  # of the model's file, in hexadecimal digits

    def check(self) -> None:
        """Raise ValueError if training cannot have written it; checksums can be forged."""
        texts = self.fingerprint, self.device, self.model_sha256
        counts, times = (self.steps, self.gaussians), (self.seconds, self.cpu_seconds)
        if not (
            all(type(text) is str for text in texts)
            and all(type(count) is int and 0 <= count <= MOST for count in counts)
            and all(type(time) in (int, float) and 0 <= time <= MOST for time in times)
        ):
            raise ValueError("a value of another kind")


def read_record(path: Path) -> StageRecord | None:
    """Read the record; None if there is none.

    Raises:
        DamagedError: it was changed or damaged.
        RunFolderError: it cannot be read.
    """
    try:
        value = json.loads(read_bytes(path))
        if value.pop(CHECKSUM) != json_digest(value):
            raise DamagedError(f"{path} is damaged (wrong checksum)")
        record = StageRecord(**value)
        record.check()
        return record
    except FileNotFoundError:
        return None
    except OSError as error:
        raise RunFolderError(f"Cannot read {path} ({error.strerror}).", UNREADABLE) from error
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise DamagedError(f"{path} is damaged (no record of a stage)") from error


def check_model(path: Path, record: StageRecord) -> None:
    """Raise DamagedError if the model does not match the record, RunFolderError if unreadable."""
    try:
        found = sha256(path)
    except FileNotFoundError as error:
        raise DamagedError(f"{path} is missing") from error
    except OSError as error:
        raise RunFolderError(f"Cannot read {path} ({error.strerror}).", UNREADABLE) from error
    if found != record.model_sha256:
        raise DamagedError(f"{path} is damaged (wrong checksum)")


@dataclass(frozen=True, kw_only=True, eq=False)
class StageResult:
    """A finished stage."""

    name: str
    record: StageRecord
    model_path: Path  # the trained model's PLY, in the world's frame
    frame: LocalFrame  # of the model
    trained: Gaussians | None = field(default=None, repr=False)  # the model, if trained here

    @cached_property
    def gaussians(self) -> Gaussians:
        """The trained model; loaded from its file on first use."""
        return self.trained or Gaussians.load_ply(self.model_path, self.frame)

    def without_model(self) -> StageResult:
        """The same result, without the model in memory."""
        return replace(self, trained=None)


def folder_of(run: Path, name: str, fingerprint: str) -> Path:
    """The folder of a stage in a run folder: `stages/NAME-FINGERPRINT`; it need not exist.

    If it does not exist, a finished stage with the same fingerprint is used, under any name: the
    box may have been renamed, or two stages of a plan may be equal.

    Raises:
        RunFolderError: the folder is a link, or not a folder.
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
    """The folder in which a stage is trained; its PLYs are in the world's frame."""

    name: str  # name of the stage, shown to the user
    folder: Path  # `folder_of` the stage
    fingerprint: str
    frame: LocalFrame = field(default_factory=LocalFrame.world)  # the frame for training
    preview: Path = Path(run_files.PREVIEW)  # file for the preview of the current Gaussians
    preview_seconds: float = 0.0  # seconds of training between two previews; 0: no previews
    named: set[str] = field(default_factory=set)  # photos already named in a warning; updated

    @property
    def _checkpoint(self) -> Path:
        return self.folder / run_files.CHECKPOINT

    def peek(self) -> StageResult | int:
        """The result of a finished stage, or the step of its checkpoint, 0 if there is none.

        Changes nothing.
        """
        with suppress(RunFolderError, DamagedError):
            if result := self._verified():
                return result
        return checkpoint_step(self._checkpoint, self.fingerprint)

    def finished(self, context: Context = QUIET) -> StageResult | None:
        """The stage's result if it is finished, or None.

        A damaged result is moved aside, with a warning, and counts as missing.

        Raises:
            RunFolderError: the folder cannot be read.
        """
        try:
            result = self._verified()
        except DamagedError as error:
            place = move_damaged(self.folder, (run_files.STAGE, run_files.MODEL))
            resumes = checkpoint_exists(self._checkpoint)
            again = "resumed from its checkpoint" if resumes else "repeated"
            context.warn(
                f"{self.name}: {error}. The stage is {again}; its damaged files are in {place}."
            )
            return None
        if result is None:
            return None
        remove_checkpoint(self._checkpoint)  # it is left if the engine was killed at the very end
        gaussians = counted(result.record.gaussians, "Gaussian")
        context.info(f"{self.name}: finished in an earlier training; its {gaussians} are used.")
        return result

    def _verified(self) -> StageResult | None:
        """The result, with checked model; None if the stage is not finished.

        Raises:
            RunFolderError: the record or the model cannot be read.
            DamagedError: one of them is damaged, the model is missing, or the record belongs to
                another stage.
        """
        path = self.folder / run_files.STAGE
        record = read_record(path)
        if record is None:
            return None
        if record.fingerprint != self.fingerprint:
            raise DamagedError(f"{path} belongs to another stage")
        model_path = self.folder / run_files.MODEL
        check_model(model_path, record)
        return StageResult(name=self.name, record=record, model_path=model_path, frame=self.frame)

    def train(
        self, start: Callable[[], Gaussians], data: StageData, config: TrainConfig, context: Context
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
            KernelError: the GPU failed, or its memory is full; a checkpoint was written if
                possible.
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
        self, start: Callable[[], Gaussians], data: StageData, config: TrainConfig, context: Context
    ) -> Trainer:
        """Train to the last step; `_save` never writes a checkpoint with NaN or Inf."""
        if checkpoint_exists(self._checkpoint):
            check = partial(check_state, config=config)
            state = load_checkpoint(self._checkpoint, self.fingerprint, context, check)
            trainer = Trainer(Gaussians(**state["parameters"]), data, config, context)
            trainer.load_state_dict(state)
            how = f"resumes at step {trainer.step}" if trainer.step else "starts at step 0"
            context.info(f"{self.name}: {how}.")
        else:
            trainer = Trainer(start(), data, config, context)

        def write_preview() -> None:
            with suppress(RunFolderError):  # on Windows, while another program reads the file
                check_held(self.folder)
                _model(trainer).save_ply(self.preview, self.frame)
                context.emit(Preview(path=str(self.preview)))

        callbacks = [
            PeriodicCallback(CHECKPOINT_SECONDS, lambda: self._save(trainer)),
            PeriodicCallback(self.preview_seconds, write_preview),
        ]
        try:
            is_done = trainer.run(context, stage=self.name, callbacks=callbacks)
        except KernelError:  # out of memory, or a lost GPU
            if trainer.is_between_steps:
                with suppress(KernelError, RuntimeError):  # out of memory again, or a broken GPU
                    self._save(trainer)
            raise
        if not is_done:
            self._save(trainer)
            raise Stopped(self.name)
        trainer.check()
        return trainer

    def _save(self, trainer: Trainer) -> None:
        trainer.check()
        check_held(self.folder)
        save_checkpoint(self._checkpoint, trainer.state_dict(), self.fingerprint)

    def _finish(self, trainer: Trainer) -> StageResult:
        model = _model(trainer).detached().to(CPU)
        path = self.folder / run_files.MODEL
        check_held(self.folder)
        model.save_ply(path, self.frame)
        record = StageRecord(
            fingerprint=self.fingerprint,
            seconds=trainer.seconds,
            cpu_seconds=trainer.cpu_seconds,
            steps=trainer.step,
            gaussians=len(model),
            device=drawing(trainer.data.device.type),
            model_sha256=sha256(path),
        )
        values = asdict(record)
        write_json(self.folder / run_files.STAGE, values | {CHECKSUM: json_digest(values)})
        remove_checkpoint(self._checkpoint)
        # In another frame, the file has rounded values. Use these, as a resumed run does.
        trained = model if self.frame.is_world else None
        return StageResult(
            name=self.name, record=record, model_path=path, frame=self.frame, trained=trained
        )


def _model(trainer: Trainer) -> Gaussians:
    """The trained model, with the focal length of its photos."""
    return replace(trainer.gaussians, photo_focal=trainer.data.photo_focal)
