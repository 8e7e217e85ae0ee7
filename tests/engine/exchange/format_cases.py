"""File formats of Gaussians under test: models, packages, and pictures of what was read."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.exchange import formats
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.rasterize.instances import Instance, render_instances
from tests.engine.clouds import CAMERA, POSE, cloud, on_black

NEEDS = {
    "compressed_ply": ("gsply",),
    "spz": ("gsply",),
    "sog": ("gsply", "imagecodecs", "sklearn"),
    "gltf": ("pygltflib",),
    "usd": ("pxr",),
    "page": ("gsply",),
}

READABLE = [form for form in formats.FORMATS if form.reads]

LEAST = {".splat": 20.0, ".sog": 25.0, ".spz": 36.0, ".compressed.ply": 40.0}
"""PSNR, dB, of small Gaussians with random colours, which no palette fits; others are exact."""


def arrays(count: int = 400, seed: int = 0) -> dict[str, np.ndarray]:
    """Gaussians in front of the camera."""
    return cloud(count, seed).arrays()


def needed(form: formats.FileFormat) -> None:
    """Skip without the packages of a format."""
    for name in NEEDS.get(form.module, ()):
        pytest.importorskip(name)


def picture(values: dict[str, np.ndarray]) -> np.ndarray:
    """Of the model from the front."""
    model = Instance(
        gaussians=Gaussians.from_arrays(values), frame=LocalFrame.world(), matrix=np.eye(4)
    )
    return on_black(render_instances([model], CAMERA, POSE)).numpy()


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.square(a - b).mean() + 1e-12))


TOOL = shutil.which("splat-transform")


def read_by(package: str, needed: str, script: str, path: Path) -> dict[str, np.ndarray]:
    """A file's content as read by npm's package; skips without it."""
    folders = [folder for folder in os.environ.get("NODE_PATH", "").split(os.pathsep) if folder]
    there = [folder for folder in folders if Path(folder, package, needed).is_file()]
    if shutil.which("node") is None or not there:
        pytest.skip(f"NODE_PATH has no {package} that reads Gaussians from glTF")
    command = ["node", "--input-type=module", "-e", script, there[0], str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return {name: np.array(values) for name, values in json.loads(done.stdout).items()}
