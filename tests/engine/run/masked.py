"""A scene whose photos have object masks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from roigs_engine.model.scene import PhotoMask, SfmScene
from roigs_engine.photos.mask_images import write_mask


def masked(scene: SfmScene, folder: Path, box: str = "thing") -> SfmScene:
    """Every second photo has a mask: the left half of the picture is the object."""
    height, width = scene.images[0].camera.height, scene.images[0].camera.width
    mask = np.zeros((height, width), bool)
    mask[:, : width // 2] = True
    path = folder / "object.png"
    write_mask(path, mask)
    small = np.where(mask, np.uint8(255), np.uint8(0))
    made = PhotoMask(digest="half", path=path, remake=lambda: write_mask(path, mask), small=small)
    images = tuple(
        replace(image, objects={box: made}) if k % 2 else image
        for k, image in enumerate(scene.images)
    )
    return replace(scene, images=images)
