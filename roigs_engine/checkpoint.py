"""Training state on disk: tensors and plain numbers, written whole, read without running code."""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import torch

from .errors import RunFolderError
from .files import atomic_write

FORMAT = 1
HINT = "Delete it to begin the stage anew, or choose another run folder."


def save_checkpoint(path: Path, state: dict[str, Any], fingerprint: str) -> None:
    """Write `state` under `path`, whole or not at all.

    Args:
        path: the file.
        state: nested dicts of tensors, numbers and strings (`Trainer.state_dict`).
        fingerprint: of the stage's settings and inputs; checked when loading.
    """
    buffer = io.BytesIO()
    torch.save({"format": FORMAT, "fingerprint": fingerprint, "state": state}, buffer)
    with atomic_write(path) as file:
        file.write(buffer.getbuffer())


def checkpoint_fingerprint(path: Path) -> str:
    """The fingerprint in a checkpoint; its tensors stay on disk. RunFolderError as loading."""
    return str(_record(path, mmap=True)["fingerprint"])


def load_checkpoint(path: Path, fingerprint: str) -> dict[str, Any]:
    """The state that `save_checkpoint` wrote.

    Raises:
        RunFolderError: the file is damaged, of another version, or of another stage.
    """
    record = _record(path, mmap=False)
    if record.get("fingerprint") != fingerprint:
        raise RunFolderError(f"The checkpoint {path} belongs to other settings.", HINT)
    state = record["state"]
    if not isinstance(state, dict):
        raise RunFolderError(f"The checkpoint {path} is damaged.", HINT)
    return state


def _record(path: Path, *, mmap: bool) -> dict[str, Any]:
    """What the file holds, its version checked."""
    try:
        record = torch.load(path, map_location="cpu", weights_only=True, mmap=mmap)
    except (OSError, RuntimeError, ValueError, EOFError, KeyError, pickle.UnpicklingError) as error:
        raise RunFolderError(f"The checkpoint {path} is damaged.", HINT) from error
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise RunFolderError(f"The checkpoint {path} is of another version.", HINT)
    return record
