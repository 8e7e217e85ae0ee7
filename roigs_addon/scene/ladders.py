"""Levels of detail: the files of an object, and which of them a view shows.

They are listed in `levels.json`, in the run folder of the object's own file. They represent the
unedited file, so edited Gaussians are drawn in full.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..geometry.frames import Matrix
from ..properties import object_props, scene_props
from ..shared import EngineError, levels, run_files
from . import display, edits, lookup

ABOVE = {"RESULT": 1, "ROI": 2}
"""Level of an object -> number of folders from its file up to the run folder."""

STALE = "The levels of detail are older than the result: they are not used. Make them again"
MISSING = "A level of detail is missing ({}): its object is drawn in full. Make the levels again"

MOST_FOLDERS = 16
"""Most run folders whose lists are cached."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Detail:
    """The levels of an object.

    Attributes:
        ladder: the ladder of its part of the scene.
        files: of the levels, the object's own one first.
        quality: for `levels.shown_levels`; None if the object is always drawn whole.
    """

    ladder: levels.Ladder
    files: tuple[str, ...]
    quality: float | None

    def shown(self, matrix: Matrix, to_clip: Matrix, focal: float) -> dict[int, float]:
        """Return the levels that a view shows: number -> density.

        Args:
            matrix: (4, 4) from the files' frame to the world.
            to_clip: (4, 4) from the world to clip space.
            focal: pixels per unit of the world where a point's w is 1.
        """
        if self.quality is None or not np.isfinite(matrix).all():
            return {0: 1.0}
        scale = float(np.linalg.norm(matrix[:3, :3], 2))  # the longest axis of a stretched object
        rate = levels.rate_in_view(self.ladder.probes, to_clip @ matrix, focal * scale)
        drawn = levels.shown_levels(self.ladder, rate, self.quality)
        numbers = {level.ply: number for number, level in enumerate(self.ladder.levels)}
        return {numbers[level.ply]: density for level, density in drawn}


@dataclass(frozen=True, kw_only=True, eq=False)
class _List:
    """A `levels.json`: its time and size, the ladders by their first files, a problem if any."""

    key: tuple[int, int]
    ladders: dict[str, levels.Ladder]
    problem: str = ""


_lists: dict[str, _List] = {}


def of(
    item: bpy.types.Object, scene: bpy.types.Scene | None, *, whole: bool = False
) -> Detail | None:
    """The levels of an object; None if it has only one, as Blender's own splats have.

    Args:
        item: the object.
        scene: in which it is shown; None gives no levels.
        whole: draw it whole, choose no level.
    """
    props = object_props(item)
    listed = _list_of(item) if scene is not None else None
    if scene is None or listed is None or display.is_native(item, viewport=True):
        return None
    if edits.file_of(item) != props.ply:
        return None
    folder, found = listed
    ladder = found.ladders.get(os.path.normpath(props.ply))
    if ladder is None or len(ladder.levels) == 1 or _modified(props.ply) > found.key[0]:
        return None
    # In edit mode, the user sees all edited points.
    settings, whole = scene_props(scene), whole or props.whole or item.mode != "OBJECT"
    return Detail(
        ladder=ladder,
        files=(props.ply, *(str(folder / level.ply) for level in ladder.levels[1:])),
        quality=settings.level_quality if settings.use_levels and not whole else None,
    )


def there_are_some(scene: bpy.types.Scene) -> bool:
    """Whether any object of a scene has levels."""
    return any(of(item, scene) is not None for item in lookup.splats(scene))


def problem(scene: bpy.types.Scene) -> str:
    """Return why levels of shown objects are not used, in one line; empty if they are used."""
    for item in lookup.splats(scene):
        props = object_props(item)
        listed = None if props.parked else _list_of(item)
        if listed is None:
            continue
        folder, found = listed
        if found.problem:
            return found.problem
        ladder = found.ladders.get(os.path.normpath(props.ply))
        if ladder is not None and _modified(props.ply) > found.key[0]:
            return STALE
        for level in ladder.levels[1:] if ladder is not None else ():
            if not os.path.isfile(folder / level.ply):
                return MISSING.format(folder / level.ply)
    return ""


def _list_of(item: bpy.types.Object) -> tuple[Path, _List] | None:
    """The run folder of an object's own file and its `levels.json`, read if it has changed."""
    props = object_props(item)
    above = ABOVE.get(props.level)
    if above is None or not props.ply:
        return None
    folder = Path(props.ply)
    for _ in range(above):
        folder = folder.parent
    name = os.path.join(folder, run_files.LEVELS_FILE)
    try:
        state = os.stat(name)
    except OSError:
        _lists.pop(name, None)
        return None
    key, known = (state.st_mtime_ns, state.st_size), _lists.get(name)
    if known is None or known.key != key:
        if len(_lists) >= MOST_FOLDERS:
            _lists.clear()
        known = _lists[name] = _read(folder, key)
    return folder, known


def _read(folder: Path, key: tuple[int, int]) -> _List:
    try:
        ladders = levels.read_ladders(folder).values()
    except EngineError as error:
        return _List(key=key, ladders={}, problem=str(error))
    first = {os.path.normpath(folder / ladder.levels[0].ply): ladder for ladder in ladders}
    return _List(key=key, ladders=first)


def _modified(path: str) -> int:
    try:
        return os.stat(path).st_mtime_ns
    except OSError:
        return 0
