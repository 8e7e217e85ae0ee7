"""Groups of boxes: those that many photos see together are trained together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set

import numpy as np

from ..errors import ConfigError
from ..model.roi import OrientedBox
from ..model.scene import Float64, Int64

SHARED = 0.25  # share of the photos of a box that see another one too: they are near
ALL = "all"
Groups = tuple[tuple[str, ...], ...]


def parsed_groups(texts: Sequence[str], boxes: Sequence[str]) -> Groups:
    """The groups that the option names, `vase,tin`, once each; boxes without one are one more.

    Args:
        texts: values of the option; `all`, unless a box has that name, is all boxes.
        boxes: names of the boxes.

    Raises:
        ConfigError: a box is unknown or is named twice, or `all` is not alone.
    """
    if ALL in texts and ALL not in boxes and len(texts) > 1:
        raise ConfigError(f"--group {ALL} is all boxes.", "Give it alone.")
    groups = [tuple(boxes) if t == ALL and ALL not in boxes else _names(t, boxes) for t in texts]
    named = [name for group in groups for name in group]
    if not all(groups):
        raise ConfigError("--group names no box.", f"The boxes are: {', '.join(boxes)}.")
    for name in named:
        if name not in boxes:
            raise ConfigError(
                f"--group names '{name}', which is no box.", f"The boxes are: {', '.join(boxes)}."
            )
        if named.count(name) > 1:
            raise ConfigError(f"--group names box '{name}' twice.", "Name each box once.")
    rest = tuple(name for name in boxes if name not in named)
    return _ordered([*groups, rest] if rest else groups, boxes)


def _names(text: str, boxes: Sequence[str]) -> tuple[str, ...]:
    """The names in one value; a box's name may hold a comma."""
    if text in boxes:
        return (text,)
    return tuple(name.strip() for name in text.split(",") if name.strip())


def groups_by_photos(seen: Mapping[str, Set[str]]) -> Groups:
    """The boxes in groups: two are in one if they share photos, or both do with a third.

    Args:
        seen: box -> names of the photos that see it.
    """
    boxes, group = list(seen), {name: name for name in seen}
    for index, one in enumerate(boxes):
        for other in boxes[:index]:
            fewer = min(len(seen[one]), len(seen[other]))
            if len(seen[one] & seen[other]) >= SHARED * max(fewer, 1):
                old, new = group[one], group[other]
                group = {name: new if of == old else of for name, of in group.items()}
    found = [tuple(n for n in boxes if group[n] == of) for of in dict.fromkeys(group.values())]
    return _ordered(found, boxes)


def _ordered(groups: Iterable[Sequence[str]], boxes: Sequence[str]) -> Groups:
    """Groups and their boxes in the order of the boxes."""
    inside = [tuple(name for name in boxes if name in group) for group in groups]
    return tuple(sorted((g for g in inside if g), key=lambda group: boxes.index(group[0])))


def nearest_group(positions: Float64, groups: Sequence[Sequence[OrientedBox]]) -> Int64:
    """(N, 3) world positions -> (N,) the group with the box that is nearest to each."""
    distances = [np.min([_distance(positions, roi) for roi in group], axis=0) for group in groups]
    return np.asarray(np.argmin(distances, axis=0), dtype=np.int64)


def _distance(positions: Float64, roi: OrientedBox) -> Float64:
    """(N,) distance of positions to a box, world units; 0 inside."""
    beyond = np.maximum(np.abs(roi.to_box(positions)) - 1, 0) * roi.half_extents
    return np.asarray(np.linalg.norm(beyond, axis=1))
