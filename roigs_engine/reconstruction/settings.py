"""Settings of a reconstruction: the defaults register photos that pycolmap's own leave out."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from ..requests.projects import FEW_PHOTOS, MANY, USUAL, ReconstructionMethod


@dataclass(frozen=True, kw_only=True)
class Settings(ReconstructionMethod):
    """What decides the result of a reconstruction: the method's options, and the masks.

    Attributes:
        masks: hash of the photos' masks, which `reconstruct` sets: features are found only where a
            mask is not black. Empty: no photo has one.
    """

    masks: str = ""

    def most_features(self, photos: int) -> int:
        """The most features of a photo in a set of so many photos.

        Few photos overlap little and have few pairs: there, more features find more, and cost less.
        """
        return self.features or (MANY if photos <= FEW_PHOTOS else USUAL)

    def of_features(self) -> dict[str, Any]:
        """The values that features depend on; if they change, the database starts again."""
        keys = ("max_side", "features", "cameras", "camera_model", "masks")
        return {key: value for key, value in asdict(self).items() if key in keys}
