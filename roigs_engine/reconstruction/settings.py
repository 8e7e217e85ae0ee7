"""Settings of a reconstruction: the defaults register photos that pycolmap's own leave out."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

FEW_PHOTOS, MANY, USUAL = 40, 8192, 2048  # photos, and their features; more photos have the usual


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What decides the result of a reconstruction.

    Attributes:
        max_side: px; features are found in photos of at most this longest side.
        features: most features of a photo; COLMAP may find up to twice as many. 0: `most_features`
            decides.
        pairs: which photos are matched, one of `choices.PAIRS`.
        neighbours: photos that each photo is matched with, unless all pairs are.
        cameras: which photos share a camera, one of `choices.CAMERAS`. auto: those of one size,
            device, lens and focal length.
        camera_model: COLMAP's name of the lens model.
        masks: hash of the photos' masks, which `reconstruct` sets: features are found only where a
            mask is not black. Empty: no photo has one.
        seed: of all random numbers.
    """

    max_side: int = 1600
    features: int = 0
    pairs: str = "auto"
    neighbours: int = 30
    cameras: str = "auto"
    camera_model: str = "SIMPLE_RADIAL"
    masks: str = ""
    seed: int = 0

    def most_features(self, photos: int) -> int:
        """The most features of a photo in a set of so many photos.

        Few photos overlap little and have few pairs: there, more features find more, and cost less.
        """
        return self.features or (MANY if photos <= FEW_PHOTOS else USUAL)

    def of_features(self) -> dict[str, Any]:
        """The values that features depend on; if they change, the database starts again."""
        keys = ("max_side", "features", "cameras", "camera_model", "masks")
        return {key: value for key, value in asdict(self).items() if key in keys}
