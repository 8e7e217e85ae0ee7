"""`stages.json`: the folders in `stages/` that belong to a run's present settings."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from .files import read_record, write_json
from .run_files import STAGES, STAGES_FILE

FOLDER = re.compile(r"[^/\\:\x00-\x1f\ud800-\udfff]+-[0-9a-f]{8}")


def write_stage_list(run: Path, stages: Mapping[str, Path]) -> None:
    """Add stages to the list: name -> folder in `run`/stages.

    Stages of other commands (baselines) stay in it. RunFolderError: the file cannot be written.
    """
    known = read_stage_list(run)
    now = {**known, **stages}
    if now != known:
        record = {name: folder.name for name, folder in now.items()}
        write_json(run / STAGES_FILE, {"stages": record})


def read_stage_list(run: Path) -> dict[str, Path]:
    """Read the list: stage -> folder, in training order; empty if it is missing or unreadable.

    A folder need not exist: the list is written before the first stage is trained.
    """
    stages = read_record(run / STAGES_FILE).get("stages")
    return {
        name: run / STAGES / folder
        for name, folder in (stages.items() if isinstance(stages, dict) else ())
        if isinstance(folder, str) and FOLDER.fullmatch(folder)
    }
