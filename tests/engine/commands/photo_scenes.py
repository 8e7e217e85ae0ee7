"""Scenes for the command `run` with photos of any kind."""

from __future__ import annotations

from pathlib import Path

from tests.engine.commands.command_line import BOX
from tests.engine.synthetic_colmap import Project, camera, write_project

LENS = camera("SIMPLE_RADIAL", 96, 72, [100.0, 48.0, 36.0, 0.05])


def scene(
    folder: Path, *, distorted: bool = False, suffix: str = "jpg", binary: bool = True
) -> Project:
    names = [f"{k}.{suffix}" for k in range(10)]
    cameras = [LENS] if distorted else []
    return write_project(folder / "scene", names=names, dots=True, cameras=cameras, binary=binary)


def arguments(project: Project, run: Path, *more: str) -> list[str]:
    tiny = ["--steps-factor", "0.003", "--test-every", "4", "--device", "cpu", "--compare"]
    return ["run", str(project.folder), "--roi", BOX, "--run-dir", str(run), *tiny, *more]
