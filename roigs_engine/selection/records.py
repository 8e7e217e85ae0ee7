"""The selection's values: its settings, the candidates it works on, and its result."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Picks:
    """What a method returns: candidate ids, best first.

    Attributes:
        order: ids, unique.
        filled_from: position in `order` from which on no photo improved the method's score and
            farthest views were taken; None when that did not happen.
        flags: degenerate cases met.
    """

    order: tuple[int, ...]
    filled_from: int | None = None
    flags: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class CameraSelection:
    """The chosen photos of one box.

    Attributes:
        roi: the box's name.
        method: one of `METHODS`.
        names: chosen photos, best first.
        scores: the score after each pick: for `coverage` the share of what all candidates together
            would give, else density x occupancy of the points in the box (both 0 to 1).
        candidates: every photo that sees the box, in name order.
        flags: sentences about degenerate cases met.
        features: candidate -> 'distance' (world units, to the box's centre), 'area' (share of the
            image that the box covers), 'keypoints' (points in the box that the photo sees).
    """

    roi: str
    method: str
    names: tuple[str, ...]
    scores: tuple[float, ...]
    candidates: tuple[str, ...]
    flags: tuple[str, ...] = ()
    features: dict[str, dict[str, float]] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        record = asdict(self)
        return {key: list(v) if isinstance(v, tuple) else v for key, v in record.items()}
