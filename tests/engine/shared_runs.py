"""Runs shared by tests of several modules: made once, by the first process that needs one."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """A folder that is made once and then only read; tests that write take a copy.

    Args:
        factory: of the session's temporary folders; xdist's processes have their own below one.
        name: of the folder.
        make: fills it.
    """
    base = factory.getbasetemp()
    base = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    folder, made = base / name, base / f"{name}.made"
    with FileLock(base / f"{name}.lock"):
        if not made.exists():
            shutil.rmtree(folder, ignore_errors=True)  # a process failed at it
            folder.mkdir()
            make(folder)
            made.touch()
    return folder
