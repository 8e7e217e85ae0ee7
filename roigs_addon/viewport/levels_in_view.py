"""Levels of detail in a viewport: an object becomes one object per level; a view shows one or two.

A view shows two levels while one fades into the other.

A level that is not yet on the GPU leaves no hole: until it arrives, the nearest available level is
drawn.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .objects import FileKey, SplatObject
from .placed import Files, Ranges, objects_of
from .view import View

Densities = dict[int, float]
"""Number of a level -> its density, see `roigs_engine.model.operations`."""


@dataclass(frozen=True, eq=False)
class InView:
    """Objects, and the levels of each that a view would show if all were on the GPU."""

    objects: Sequence[SplatObject]
    chosen: Sequence[Densities]

    @classmethod
    def of(cls, objects: Sequence[SplatObject], view: View, *, fade: bool = True) -> InView:
        """Choose levels for a view; with `fade`, an object may get two."""
        to_clip = np.array(view.projection @ view.matrix, float)
        focal = max(abs(view.projection[k][k]) * view.size[k] / 2 for k in (0, 1))
        chosen = [
            item.levels.detail.shown(np.array(item.matrix, float), to_clip, focal)
            if item.levels and item.visible
            else {}
            for item in objects
        ]
        if not fade:
            chosen = [{max(one, key=one.__getitem__): 1.0} if one else {} for one in chosen]
        return cls(objects, chosen)

    def wanted(self) -> list[SplatObject]:
        """Return the objects to draw: each level as an object, visible if it is chosen."""
        return self._apart(None)

    def among(self, files: Iterable[FileKey]) -> list[SplatObject]:
        """Return them with the levels on the GPU; `files` has one entry for each object there."""
        return self._apart(Counter(file.path for file in files))

    def counts(self, files: Files, ranges: Ranges, there: Iterable[FileKey]) -> tuple[int, int]:
        """Return the numbers of Gaussians: drawn, and without levels.

        Args:
            files, ranges: of the set on the GPU.
            there: the drawn ones of these files.
        """
        sizes = {file.path: stop - start for file, (start, stop) in zip(files, ranges, strict=True)}
        drawn = [item for item in objects_of(files, self.among(there)) if item and item.visible]
        whole = [
            item.levels.detail.ladder.levels[0].gaussians
            if item.levels
            else sizes.get(item.file.path, 0)
            for item in self.objects
            if item.visible
        ]
        return sum(sizes[item.file.path] for item in drawn), sum(whole)

    def _apart(self, there: Counter[str] | None) -> list[SplatObject]:
        apart = []
        for item, chosen in zip(self.objects, self.chosen, strict=True):
            if item.levels is None:
                if there is not None and item.visible:
                    there[item.file.path] -= 1
                apart.append(item)
                continue
            shown = chosen if there is None else _standing_in(chosen, item.levels.files, there)
            apart += [
                replace(
                    item,
                    file=file,
                    levels=None,
                    visible=item.visible and number in shown,
                    density=shown.get(number, 1.0),
                )
                for number, file in enumerate(item.levels.files)
            ]
        return apart


def _standing_in(chosen: Densities, files: Sequence[FileKey], there: Counter[str]) -> Densities:
    """Return the chosen levels on the GPU, else the nearest one; remove them from `there`."""
    held = [number for number, file in enumerate(files) if there[file.path] > 0]
    if not chosen or not held:
        return chosen
    found = {number: density for number, density in chosen.items() if number in held}
    if not found:
        wanted = min(chosen)
        found = {min(held, key=lambda number: abs(number - wanted)): 1.0}
    elif len(found) < len(chosen):
        found = dict.fromkeys(found, 1.0)
    for number in found:
        there[files[number].path] -= 1
    return found
