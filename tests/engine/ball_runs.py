"""A run folder with a ball in a box, as a training leaves it, and its scene."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import torch

from roigs_engine.formats.rois import rois_document
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.roi import OrientedBox
from tests.engine.levels.balls import cloud
from tests.engine.synthetic_colmap import write_project

NAMES = [f"{number}.png" for number in range(6)]


BALL = OrientedBox.between("ball", [-0.5] * 3, [0.5] * 3)
HALF = OrientedBox.between("half", [-0.5, -0.5, 0.0], [0.5] * 3)


def write_run(
    folder: Path,
    *,
    model: Gaussians | None = None,
    boxes: tuple[OrientedBox, ...] = (BALL,),
    photos: int = 6,
    sim3: pycolmap.Sim3d | None = None,
) -> Path:
    """A run folder with a ball in a box, and its scene; `sim3` moves and scales the world."""
    scene = write_project(folder / "scene", names=NAMES[:photos]).folder
    model = model or cloud(3000, 0, size=0.4)
    if sim3 is not None:
        sparse = str(scene / "sparse/0")
        world = pycolmap.Reconstruction(sparse)
        world.transform(sim3)
        world.write_binary(sparse)
        matrix = torch.from_numpy(sim3.matrix()).float()
        means = model.means @ matrix[:, :3].T + matrix[:, 3]
        sizes = model.log_scales + float(np.log(sim3.scale))
        model = model.with_tensors({"means": means, "log_scales": sizes})
        boxes = tuple(_moved(box, sim3) for box in boxes)
    run = folder / "run"
    model.save_ply(run / "result.ply")
    rois = run / "boxes.json"
    rois.write_text(rois_document(list(boxes)))
    settings = {"scene": str(scene), "rois": str(rois), "test_every": 0}
    (run / "manifest.json").write_text('{"config": {}}')
    (run / "settings.json").write_text(json.dumps(settings))
    return run


def _moved(box: OrientedBox, sim3: pycolmap.Sim3d) -> OrientedBox:
    whole = np.vstack([sim3.matrix(), [0, 0, 0, 1]])
    to_box = box.world_to_box @ np.linalg.inv(whole)
    to_box[:3] *= sim3.scale
    return replace(box, world_to_box=to_box, half_extents=box.half_extents * sim3.scale)
