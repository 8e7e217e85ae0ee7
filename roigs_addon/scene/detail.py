"""Switches a box between its two objects: refined, or from the whole-scene model.

The user sees them as **Result** and **First Pass**. The hidden one is switched off by properties
that Alt-H does not change. A copy gets its own second object when it needs one. The refined object
has levels of detail if they were made (`ladders`). They are chosen automatically, or the object is
always drawn whole.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest

import bpy
import numpy as np
from mathutils import Matrix

from ..errors import AddonError
from ..geometry import frames
from ..properties import RoigsObject, object_props
from . import edits, ladders, lookup, ownership

FINE, COARSE = "ROI", "SCENE"


@dataclass(frozen=True, kw_only=True)
class Pair:
    """The two objects of a box in one place; None if one was not made, or was deleted."""

    fine: bpy.types.Object | None
    coarse: bpy.types.Object | None

    @property
    def shown(self) -> bpy.types.Object | None:
        """Return the object that is not switched off; None if there is none."""
        found = (item for item in (self.fine, self.coarse) if item and not object_props(item).off)
        return next(found, None)


def pairs(scene: bpy.types.Scene) -> list[Pair]:
    """Return the pairs of all boxes, copies after their originals."""
    groups: dict[tuple[ownership.Box, str], dict[str, list[bpy.types.Object]]] = {}
    for item, props in _of_boxes(scene):
        if not props.parked:  # parked objects belong to another result
            key = ownership.box_of(scene, item), props.pair
            group = groups.setdefault(key, {FINE: [], COARSE: []})
            group[props.level].append(item)
    return [
        Pair(fine=fine, coarse=coarse)
        for group in groups.values()
        for fine, coarse in zip_longest(group[FINE], group[COARSE])
    ]


def set_detail(scene: bpy.types.Scene, pair: Pair, fine: bool, *, auto: bool | None = None) -> None:
    """Show a box's refined object, or its whole-scene one, in the place of the other.

    Args:
        scene: with the objects.
        pair: the objects.
        fine: whether to show the refined one.
        auto: whether its level of detail is then chosen automatically; None: as before.

    Raises:
        AddonError: the result has no such model of the box.
    """
    target, other = (pair.fine, pair.coarse) if fine else (pair.coarse, pair.fine)
    if target is None and other is not None:
        target = _made(scene, other, FINE if fine else COARSE)
    if target is None:
        return
    if fine and auto is not None:
        set_auto(scene, target, auto)
    seen = other if other is not None and not object_props(other).off else None
    if object_props(target).off:
        object_props(target).off = False
        target.hide_viewport = seen is not None and seen.hide_viewport
        target.hide_render = seen is not None and seen.hide_render
        if seen is not None:
            _stand(target, seen)
            target.pass_index = seen.pass_index  # so mattes by this index keep working
    if seen is not None:
        switch_off(seen)


def set_auto(scene: bpy.types.Scene, item: bpy.types.Object, auto: bool) -> None:
    """Choose an object's level of detail automatically, or draw all of it.

    Without levels, this stays automatic, so that levels made later are used.
    """
    object_props(item).whole = not auto and ladders.of(item, scene) is not None


def switch_off(item: bpy.types.Object) -> None:
    """Hide an object because the other one of its pair is shown."""
    object_props(item).off = item.hide_viewport = item.hide_render = True


def reset(scene: bpy.types.Scene) -> None:
    """Show every box of the scene's own result refined."""
    for pair in pairs(scene):
        if pair.fine is not None and ownership.is_own(scene, pair.fine):
            set_detail(scene, pair, True)


def _of_boxes(scene: bpy.types.Scene) -> Iterator[tuple[bpy.types.Object, RoigsObject]]:
    for item in lookup.splats(scene):
        if (props := object_props(item)).level in (FINE, COARSE):
            yield item, props


def _made(scene: bpy.types.Scene, item: bpy.types.Object, level: str) -> bpy.types.Object:
    """Create the second object of a copy; the two become a pair of their own."""
    own, box = object_props(item), ownership.box_of(scene, item)
    same = [(o, props) for o, props in _of_boxes(scene) if ownership.box_of(scene, o) == box]
    source = next((o for o, props in same if props.level == level and not props.parked), None)
    if source is None:
        kind = "refined" if level == FINE else "first-pass"
        raise AddonError(f"This result has no {kind} model of '{own.roi}'.")
    made = source.copy()
    made.animation_data_clear()
    for collection in item.users_collection:
        collection.objects.link(made)
    taken = {props.pair for _, props in same}
    props = object_props(made)
    props.pair = own.pair = next(str(n) for n in range(2, len(taken) + 3) if str(n) not in taken)
    props.exposure, props.tint = own.exposure, own.tint
    switch_off(made)
    return made


def _stand(target: bpy.types.Object, item: bpy.types.Object) -> None:
    """Put an object where another one is; their meshes may have other origins."""
    target.parent, target.parent_type = item.parent, item.parent_type
    target.parent_bone = item.parent_bone
    target.matrix_parent_inverse = item.matrix_parent_inverse
    basis, between = item.matrix_basis.copy(), _frame(item) @ np.linalg.inv(_frame(target))
    if not np.allclose(between, np.eye(4), atol=1e-6):
        basis = basis @ Matrix(between.tolist())
    target.matrix_basis = basis


def _frame(item: bpy.types.Object) -> frames.Matrix:
    mesh = item.data
    return edits.whole_frame(mesh) if isinstance(mesh, bpy.types.Mesh) else np.eye(4)
