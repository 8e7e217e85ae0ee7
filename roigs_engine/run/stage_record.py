"""`stage.json`: what a finished stage is, with checksums of its model and of the record itself."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

from ..errors import RunFolderError
from ..formats.files import UNREADABLE, read_bytes, sha256, write_json
from ..formats.text import json_digest

CHECKSUM = "checksum"


class DamagedError(Exception):
    """A finished stage cannot be used; the text says why."""


@dataclass(frozen=True, kw_only=True)
class StageRecord:
    """A finished stage.

    Attributes:
        fingerprint: of the stage.
        seconds: of training, without checkpoints and evaluation.
        cpu_seconds: the same as CPU time of all threads.
        steps: of training.
        gaussians: their number.
        device: the type of device that it was trained on: `cpu`, `cuda`.
        model_sha256: of the file with the model, in hexadecimal digits.
    """

    fingerprint: str
    seconds: float
    cpu_seconds: float
    steps: int
    gaussians: int
    device: str
    model_sha256: str


def write_record(path: Path, record: StageRecord) -> None:
    """Write the record with its checksum; RunFolderError if that fails."""
    values = asdict(record)
    write_json(path, values | {CHECKSUM: json_digest(values)})


def read_record(path: Path) -> StageRecord | None:
    """The record; None if there is none.

    Raises:
        DamagedError: it is not as it was written.
        RunFolderError: it cannot be read.
    """
    try:
        value = json.loads(read_bytes(path))
        damaged = not isinstance(value, dict) or value.pop(CHECKSUM, None) != json_digest(value)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise RunFolderError(f"Cannot read {path} ({error.strerror}).", UNREADABLE) from error
    except (ValueError, RecursionError) as error:
        raise DamagedError(f"{path} is damaged (not JSON)") from error
    if damaged:
        raise DamagedError(f"{path} is damaged (wrong checksum)")
    try:
        record = StageRecord(
            fingerprint=str(value["fingerprint"]),
            seconds=float(value["seconds"]),
            cpu_seconds=float(value["cpu_seconds"]),
            steps=int(value["steps"]),
            gaussians=int(value["gaussians"]),
            device=str(value["device"]),
            model_sha256=str(value["model_sha256"]),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise DamagedError(f"{path} is incomplete") from error
    if not math.isfinite(record.seconds + record.cpu_seconds):
        raise DamagedError(f"{path} is damaged (no finite times)")
    return record


def check_model(path: Path, record: StageRecord) -> None:
    """Make sure that the model is the one of the record.

    Raises:
        DamagedError: it is not, or is missing.
        RunFolderError: it cannot be read.
    """
    try:
        found = sha256(path)
    except FileNotFoundError as error:
        raise DamagedError(f"{path} is missing") from error
    except OSError as error:
        raise RunFolderError(f"Cannot read {path} ({error.strerror}).", UNREADABLE) from error
    if found != record.model_sha256:
        raise DamagedError(f"{path} is damaged (wrong checksum)")
