"""A project whose photos, and their EXIF, have exposures of choice."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from roigs_engine.photos.exposures import APERTURE, EXIF_IFD, ISO, TIME
from roigs_engine.photos.profiles import srgb_curve, srgb_values
from tests.engine.synthetic_colmap import write_project

NAMES = tuple(f"{letter}.jpg" for letter in "abcdefgh")
STOPS = np.array([-1.0, 0.5, 0.0, 1.2, -0.6, 0.0, 0.3, -0.2])
POINTS = np.random.default_rng(3).uniform(-0.8, 0.8, (150, 3))


def project(
    folder: Path, shown: np.ndarray, said: np.ndarray | None, points: np.ndarray = POINTS
) -> None:
    """Grey photos that differ by the stops `shown`; their EXIF says `said`."""
    write_project(folder, names=NAMES, points=points)
    light = srgb_curve(np.full((72, 96, 3), 0.4))
    for index, name in enumerate(NAMES):
        values = srgb_values(light * 2.0 ** shown[index])
        pixels = (255 * values.clip(0, 1)).round().astype(np.uint8)
        exif = Image.Exif()
        if said is not None:
            tags = {TIME: 2.0 ** said[index] / 64, APERTURE: 2.8, ISO: 100}
            exif.get_ifd(EXIF_IFD).update(tags)
        path = folder / "images" / name
        Image.fromarray(pixels).save(path, quality=95, exif=exif)
