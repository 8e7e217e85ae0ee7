"""Projects whose one photo a lens has distorted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tests.engine.synthetic_colmap import Project, camera, write_project

F, FX, FY, CX, CY = 200.0, 200.0, 190.0, 113.0, 97.0  # for photos of 240 x 180 pixels

DISTORTED = {
    "SIMPLE_RADIAL": [F, CX, CY, 0.08],
    "RADIAL": [F, CX, CY, -0.15, 0.05],
    "OPENCV": [FX, FY, CX, CY, 0.12, -0.04, 0.004, -0.003],
    "OPENCV_FISHEYE": [FX, FY, CX, CY, 0.05, -0.01, 0.002, 0.001],
    "FULL_OPENCV": [FX, FY, CX, CY, 0.1, -0.03, 0.002, 0.003, 0.01, 0.02, 0.01, 0.005],
    "FOV": [FX, FY, CX, CY, 0.6],
    "SIMPLE_RADIAL_FISHEYE": [F, CX, CY, 0.05],
    "RADIAL_FISHEYE": [F, CX, CY, 0.05, -0.02],
    "THIN_PRISM_FISHEYE": [FX, FY, CX, CY, 0.05, -0.02, 0.002, 0.001, 0.003, 0.001, 0.002, 0.001],
    "RAD_TAN_THIN_PRISM_FISHEYE": [
        *(FX, FY, CX, CY, 0.05, -0.02, 0.003, 0.001, 0.001, 0.0),
        *(0.002, 0.001, 0.001, 0.0, 0.002, 0.0),
    ],
    "SIMPLE_DIVISION": [F, CX, CY, -0.1],
    "DIVISION": [FX, FY, CX, CY, -0.1],
    "SIMPLE_FISHEYE": [F, CX, CY],
    "FISHEYE": [FX, FY, CX, CY],
    "EUCM": [FX, FY, CX, CY, 0.5, 1.1],
}


def grid() -> np.ndarray:
    """(P, 3) points on slanted sheets, far enough apart to be told from each other on a photo."""
    x, y = np.meshgrid(np.linspace(-1.5, 1.5, 7), np.linspace(-1.1, 1.1, 6))
    return np.stack([x, y, 0.25 * x + 0.1 * y], axis=-1).reshape(-1, 3)


def distorted(folder: Path, model: str = "OPENCV", **settings: Any) -> Project:
    """One photo of dots by a camera of that model."""
    made = camera(model, 240, 180, DISTORTED[model])
    return write_project(
        folder, names=["a.png"], cameras=[made], points=grid(), dots=True, **settings
    )
