"""Shared fixtures of the job tests."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture
def spec(addon: ModuleType, tmp_path: Path):
    """Makes the `JobSpec` of a fake job; `taken` grows when its results are imported."""
    from roigs_addon.jobs.spec import JobSpec

    taken: list[str] = []

    def make(**changes: object) -> JobSpec:
        values = {"title": "Testing", "arguments": ["train"], "log": tmp_path / "log.txt"}
        return JobSpec(**(values | {"on_done": lambda: taken.append("done")} | changes))

    make.taken = taken
    return make
