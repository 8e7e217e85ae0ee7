"""One stage of a run in its own folder: begun, continued, or taken as it was finished before.

A stage folder holds `checkpoint.bin` while the stage runs, and `model.ply` with `stage.json` once
it is done. The fingerprint in both names everything that decides the stage's result.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..cuda.device import CPU
from ..errors import RunFolderError, Stopped, TrainingError
from ..formats.events import Emit, Message, Preview, StageStarted
from ..formats.files import read_json, write_json
from ..model.gaussians import Gaussians
from ..run.archive import put_away, take_back
from .checkpoint import (
    checkpoint_exists,
    checkpoint_fingerprint,
    load_checkpoint,
    remove_checkpoint,
    save_checkpoint,
)
from .config import TrainConfig
from .trainer import StageData, Trainer


@dataclass(frozen=True, kw_only=True, eq=False)
class StageResult:
    """A finished stage.

    Attributes:
        name: the stage's folder name.
        gaussians: the trained model.
        seconds: of training, checkpoints and evaluation left out.
        cpu_seconds: the same by the process's clock, which counts every thread's time and only
            what this process was given: where other programs run, it is what to compare.
        fingerprint: of everything that decided the result.
    """

    name: str
    gaussians: Gaussians
    seconds: float
    cpu_seconds: float
    fingerprint: str


def fingerprint(data: StageData, config: TrainConfig, start: str, order: Any) -> str:
    """Hash of what decides a stage's result.

    Args:
        data, config: of the stage.
        start: names the Gaussians it starts from (the fingerprint of the stage they come from).
        order: JSON-able description of the order of photos.
    """
    record = {
        "config": asdict(config),
        "images": [(i.name, asdict(i.camera), i.world_to_camera.tolist()) for i in data.images],
        "rois": [roi.to_dict() for roi in data.rois],
        "capacities": [asdict(capacity) for capacity in data.capacities or ()],
        "extent": data.extent,
        "seed": data.seed,
        "start": start,
        "order": order,
    }
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True, kw_only=True, eq=False)
class Stage:
    """What to train, and where.

    Attributes:
        name: shown to people; the last part of `folder`.
        folder: the stage's own.
        data, config: see `Trainer`.
        start: the Gaussians to start from.
        fingerprint: see `fingerprint`.
        update: put a stage of another fingerprint away instead of refusing to overwrite it.
        preview_seconds: of training between two previews; 0: none.
    """

    name: str
    folder: Path
    data: StageData
    config: TrainConfig
    start: Gaussians
    fingerprint: str
    update: bool = False
    preview_seconds: float = 0.0

    def run(self, emit: Emit, should_stop: Callable[[], bool]) -> StageResult:
        """Finish the stage, from wherever it is.

        Raises:
            Stopped: `should_stop` said so; a checkpoint was written.
            RunFolderError: the folder belongs to other settings, or is damaged.
            TrainingError: twice, training came to numbers that are none.
        """
        if self.update:
            self._make_room(emit)
        finished = self._finished()
        if finished is not None:
            remove_checkpoint(self._checkpoint)  # left where the engine was killed at the very end
            emit(Message(text=f"{self.name}: done before, {len(finished.gaussians)} Gaussians."))
            return finished
        emit(StageStarted(stage=self.name, total=self.config.steps))
        try:
            trainer = self._trained(emit, should_stop)
        except TrainingError as error:
            text = f"{self.name}: {error.message} Training goes back once, and on from there."
            emit(Message(text=text, level="warning"))
            trainer = self._trained(emit, should_stop)
        for text in trainer.health.outliers():
            emit(Message(text=f"{self.name}: {text}", level="warning"))
        return self._finish(trainer)

    def _trained(self, emit: Emit, should_stop: Callable[[], bool]) -> Trainer:
        """Train to the end from the last checkpoint, which is always a good one."""
        trainer = self._trainer(emit)
        done = trainer.run(
            stage=self.name,
            emit=emit,
            should_stop=should_stop,
            on_pause=lambda: self._save(trainer),
            on_preview=lambda: self._preview(trainer, emit),
            preview_seconds=self.preview_seconds,
        )
        if not done:
            self._save(trainer)
            raise Stopped(self.name)
        trainer.check()
        return trainer

    @property
    def _checkpoint(self) -> Path:
        return self.folder / "checkpoint.bin"

    def _trainer(self, emit: Emit) -> Trainer:
        """At step 0, or where the checkpoint says."""
        if not checkpoint_exists(self._checkpoint):
            return Trainer(self.start, self.data, self.config)
        state = load_checkpoint(self._checkpoint, self.fingerprint, emit)
        trainer = Trainer(Gaussians(**state["parameters"]), self.data, self.config)
        trainer.load_state_dict(state)
        emit(Message(text=f"{self.name}: goes on at step {trainer.step}."))
        return trainer

    def _save(self, trainer: Trainer) -> None:
        trainer.check()
        save_checkpoint(self._checkpoint, trainer.state_dict(), self.fingerprint)

    def _preview(self, trainer: Trainer, emit: Emit) -> None:
        """Show the present model; left out when it cannot be written (a reader on Windows)."""
        path = self.folder.parent / "preview.ply"
        with suppress(RunFolderError):
            trainer.gaussians.save_ply(path)
            emit(Preview(path=str(path)))

    def _make_room(self, emit: Emit) -> None:
        """Put away what was trained otherwise, and take back what was put away of this."""
        present = self._present()
        if present == self.fingerprint:
            return
        if present is not None:
            put_away(self.folder, present)
            text = f"{self.name}: other settings or photos; the earlier one is in older/."
            emit(Message(text=text))
        take_back(self.folder, self.fingerprint)

    def _present(self) -> str | None:
        """The fingerprint of what is in the folder, finished or not; None: nothing."""
        finished = self.folder / "stage.json"
        if finished.exists():
            record = read_json(finished)
            return str(record.get("fingerprint")) if isinstance(record, dict) else "damaged"
        return (
            checkpoint_fingerprint(self._checkpoint)
            if checkpoint_exists(self._checkpoint)
            else None
        )

    def _finish(self, trainer: Trainer) -> StageResult:
        model = trainer.gaussians.detached().to(CPU)
        model.save_ply(self.folder / "model.ply")
        record = {
            "fingerprint": self.fingerprint,
            "seconds": trainer.seconds,
            "cpu_seconds": trainer.cpu_seconds,
            "steps": trainer.step,
            "gaussians": len(model),
            "device": self.data.device.type,
        }
        write_json(self.folder / "stage.json", record)
        remove_checkpoint(self._checkpoint)
        return StageResult(
            name=self.name,
            gaussians=model,
            seconds=trainer.seconds,
            cpu_seconds=trainer.cpu_seconds,
            fingerprint=self.fingerprint,
        )

    def _finished(self) -> StageResult | None:
        path = self.folder / "stage.json"
        if not path.exists():
            return None
        record = read_json(path)
        if not isinstance(record, dict) or record.get("fingerprint") != self.fingerprint:
            raise RunFolderError(
                f"{self.folder} was trained with other settings or photos.",
                "Add --update to keep it in older/ and train anew, or choose another --run-dir.",
            )
        return StageResult(
            name=self.name,
            gaussians=Gaussians.load_ply(self.folder / "model.ply"),
            seconds=float(record["seconds"]),
            cpu_seconds=float(record["cpu_seconds"]),
            fingerprint=self.fingerprint,
        )
