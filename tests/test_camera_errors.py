"""The benchmark of camera errors: the true cameras have none, others have."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pycolmap

from benchmarks.camera_errors import main
from tests.engine.synthetic_colmap import camera, write_project


def test_errors_are_those_of_the_cameras(tmp_path: Path, capsys) -> None:  # type: ignore[no-untyped-def]
    lens = camera("PINHOLE", 320, 240, [300.0, 300.0, 160.0, 120.0])
    made = write_project(tmp_path, names=[f"{k}.png" for k in range(6)], cameras=[lens], arc=1.5)
    photos = {
        name: {
            "centre": (-pose[:3, :3].T @ pose[:3, 3]).tolist(),
            "rotation": pose[:3, :3].T.tolist(),
        }
        for name, pose in zip(made.names, made.poses, strict=True)
    }
    truth = {
        "width": 320,
        "height": 240,
        "focal": 300.0,
        "objects": {"box": {"min": [-0.3, -0.2, -0.3], "max": [0.3, 0.2, 0.3]}},
        "photos": photos,
    }
    (tmp_path / "truth.json").write_text(json.dumps(truth), encoding="utf-8")
    model = tmp_path / "sparse" / "0"

    def error() -> float:
        assert main([str(model), "--truth", str(tmp_path / "truth.json")]) == 0
        return float(capsys.readouterr().out.splitlines()[-1].split("|")[4])

    assert error() < 0.001
    scene = pycolmap.Reconstruction(str(model))
    pose = scene.images[3].cam_from_world()
    turn = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.0, 0.01, 0.0])), np.zeros(3))
    scene.frames[scene.images[3].frame_id].set_cam_from_world(1, turn * pose)  # 3 px aside
    scene.write(str(model))
    assert error() > 0.5
