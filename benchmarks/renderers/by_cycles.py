"""Pictures by Cycles: what `in_cycles.py` is asked for, and what comes back."""

from __future__ import annotations

import json
import os
import subprocess
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from roigs_engine.model.scene import PosedImage, SfmScene
from roigs_engine.rasterize.light import to_srgb

ROOT = Path(__file__).resolve().parents[2]
IN_BLENDER = Path(__file__).with_name("in_cycles.py")
PASS = 16
"""Samples of a picture. A view has an even number of pictures; the halves' difference is noise."""


def pictures(given: Namespace, scene: SfmScene) -> Iterator[tuple[str, Tensor, float]]:
    """Name, picture (H, W, 3) in sRGB and squared error by noise, photo by photo."""
    out = given.out.resolve()
    seeds = range(2 * max(1, round(given.samples / PASS / 2)))
    wanted = [
        {"file": str(_file(out, image, seed)), "name": image.name, "seed": seed}
        for seed in seeds
        for image in scene.images
        if not _file(out, image, seed).is_file()
    ]
    if wanted:
        job = out / "job.json"
        job.write_text(json.dumps(_job(given, scene) | {"pictures": wanted}))
        places = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
        variables = os.environ | {"PYTHONPATH": os.pathsep.join(places)}
        with (out / "blender.log").open("w") as log:
            command = [given.program, str(IN_BLENDER), str(job)]
            subprocess.run(command, check=True, env=variables, stdout=log)
    for image in scene.images:
        light = np.array([np.load(_file(out, image, seed)) for seed in seeds])
        halves = [_shown(light[half::2]) for half in (0, 1)]
        noise = float((halves[0] - halves[1]).square().mean()) / 4
        yield image.name, _shown(light), noise


def _shown(light: NDArray[np.float32]) -> Tensor:
    """(H, W, 3) sRGB values of the mean of pictures (S, H, W, 3)."""
    return to_srgb(torch.from_numpy(light.mean(axis=0))).clamp(0, 1)


def _file(out: Path, image: PosedImage, seed: int) -> Path:
    return out / f"{image.name.replace('/', '_')}-{seed}.npy"


def _job(given: Namespace, scene: SfmScene) -> dict[str, Any]:
    photos = {
        image.name: {
            "name": image.name,
            "world_to_camera": image.world_to_camera.tolist(),
            **asdict(image.camera),
        }
        for image in scene.images
    }
    return {
        "model": str(given.model.resolve()),
        "samples": PASS,
        "threads": given.threads,
        "extent": scene.extent(),
        "photos": photos,
    }
