"""The example for scripts, as a person starts it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from roigs_addon.engine.python import VARIABLE
from tests.addon.photo_cases import photos_in
from tests.addon.scenes import ROOT

pytestmark = pytest.mark.blender

EXAMPLE = ROOT / "roigs_addon" / "examples" / "headless.py"


def started(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The example in another Blender like this one."""
    import bpy

    command = [sys.executable, str(EXAMPLE)]
    if bpy.app.binary_path:
        program = os.environ.get("ROIGS_BLENDER") or bpy.app.binary_path
        command = [program, "-b", "--factory-startup", "--python", str(EXAMPLE), "--"]
    environment = {**os.environ, VARIABLE: os.environ.get(VARIABLE) or sys.executable}
    command += [str(argument) for argument in arguments]
    return subprocess.run(
        command, capture_output=True, text=True, env=environment, timeout=600, check=False
    )


@pytest.mark.slow
def test_from_photos_to_a_picture(engine: object, tmp_path: Path) -> None:
    photos, out = photos_in(tmp_path / "photos", 8), tmp_path / "out"
    small = ("--max-side", 96, "--steps-factor", 0.004)
    done = started("--photos", photos, "--out", out, *small)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "8 of 8 photos registered" in done.stdout + done.stderr
    for name in ("scene.blend", "result.ply", "picture.png", "colmap/reconstruction.md"):
        assert (out / name).is_file()


def test_it_needs_photos_or_a_model(engine: object, tmp_path: Path) -> None:
    done = started("--out", tmp_path)
    assert done.returncode == 2 and "give --photos or --colmap" in done.stderr
    done = started("--photos", tmp_path, "--out", tmp_path / "out")
    (said,) = (line for line in done.stderr.splitlines() if line.startswith("error: "))
    assert done.returncode == 2 and "has no photos" in said and "headless" not in done.stderr
