"""Photos for the tests: some of the demo's, made small."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

DEMO = Path(__file__).resolve().parents[3] / "demo/scene/images"


def demo_photos(pattern: str, count: int) -> list[Path]:
    """The first photos of the demo whose names fit."""
    found = sorted(DEMO.glob(pattern))[:count]
    assert len(found) == count
    return found


def copy_photos(folder: Path, photos: list[Path], names: list[str], scale: float = 1.0) -> None:
    """Copies of photos under other names, or smaller ones."""
    for path, name in zip(photos, names, strict=True):
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if scale == 1:
            target.write_bytes(path.read_bytes())
            continue
        with Image.open(path) as photo:
            size = round(photo.width * scale), round(photo.height * scale)
            photo.resize(size, Image.Resampling.LANCZOS).save(target, exif=photo.getexif())


def write_noise(path: Path, seed: int = 0, size: tuple[int, int] = (320, 240)) -> None:
    """A photo of noise, which no other photo matches."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(seed).integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path)
