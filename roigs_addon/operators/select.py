"""Step «Cameras»: the photos that each box is refined on, chosen by the engine, edited by hand."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, StringProperty

from .. import jobs, lookup, regions, requests, run_folders
from ..engine.client import Outcome
from ..engine.python import FOR_READING
from ..errors import AddonError
from ..photo import Photo
from .base import FRESH, EngineJob, OperatorResult, available

CHOSEN_COLOUR = (0.1, 0.8, 0.3, 1.0)
CHOSEN_FOR = "roigs_chosen_for"
"""Custom property of the collection of a box's photos: the box's name."""
GAUSSIAN_PROCESS = ("gp6", "gp9")


class SelectCameras(EngineJob, bpy.types.Operator):
    """Choose the photos that show each box best"""

    bl_idname = "roigs.select_cameras"
    bl_label = "Select Cameras"

    active_only: BoolProperty(name="Active Box Only", default=False, options=FRESH)

    @property
    def packages(self) -> tuple[str, ...]:
        """The Gaussian process is scikit-learn's; the other methods need numpy and scipy alone."""
        gp = bpy.context.scene.roigs.method in GAUSSIAN_PROCESS
        return (*FOR_READING, *(("scipy", "sklearn") if gp else ()))

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A model, a box, and an engine at rest."""
        return available(cls, blocked(context))

    def work(self, context: bpy.types.Context) -> jobs.Work:
        """Select into the run folder, then into the boxes."""
        scene = context.scene
        rois = _chosen_rois(context, self.active_only)
        request = requests.write_selection_request(scene, rois)
        out = request.parent / "selected"

        names, find = {roi.name for roi in rois}, run_folders.finder(scene)

        def take(_: Outcome) -> None:
            if now := find():
                for roi in lookup.rois(now):
                    if roi.name in names:
                        _take_selection(roi, now, out / f"{roi.name}.json")

        return jobs.Work(
            title="Selecting",
            arguments=["select", str(request), "--out", str(out)],
            log=request.parent / "engine.log",
            on_done=take,
        )


def blocked(context: bpy.types.Context) -> str:
    """Why neither selection nor training can start; empty when they can."""
    if jobs.busy():
        return "The engine is busy"
    if not context.scene.roigs.colmap:
        return "Import a COLMAP model first"
    return "" if lookup.rois(context.scene) else "Add a ROI around the object first"


def _chosen_rois(context: bpy.types.Context, active_only: bool) -> list[bpy.types.Object]:
    active = lookup.active_roi(context)
    if active_only and active is not None:
        return [active]
    return lookup.rois(context.scene)


def _take_selection(roi: bpy.types.Object, scene: bpy.types.Scene, path: Path) -> None:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        names = [str(name) for name in record["names"]]
        scores = [float(score) for score in record.get("scores") or [0.0] * len(names)]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise AddonError(f"The selection of «{roi.name}» is unreadable ({error}).") from error
    chosen = roi.roigs.selection
    chosen.clear()
    for name, score in zip(names, scores, strict=False):
        item = chosen.add()
        item.name, item.score = name, score
    roi.roigs.selection_index = 0
    roi.roigs.selected_box = regions.box_key(roi, scene)
    mark_chosen(scene)


def mark_chosen(scene: bpy.types.Scene) -> None:
    """Colour the chosen cameras and collect them, a collection for each box."""
    found = lookup.cameras(scene)
    chosen_by_any, in_use = set(), set()
    for roi in lookup.rois(scene):
        names = {item.name for item in roi.roigs.selection} & set(found)
        chosen_by_any |= names
        if names:
            shelf = _collection(scene, roi.name)
            for item in set(shelf.objects) - {found[name] for name in names}:
                shelf.objects.unlink(item)
            for name in names - {photo.name for photo in _photos(shelf.objects)}:
                shelf.objects.link(found[name])
            in_use.add(shelf)
    for shelf in set(_collections(scene)) - in_use:  # the box is gone, renamed or has no photos
        bpy.data.collections.remove(shelf)
    for name, camera in found.items():
        camera.color = CHOSEN_COLOUR if name in chosen_by_any else (1.0, 1.0, 1.0, 1.0)


def _collections(scene: bpy.types.Scene) -> list[bpy.types.Collection]:
    return [shelf for shelf in scene.collection.children if CHOSEN_FOR in shelf]


def _collection(scene: bpy.types.Scene, roi: str) -> bpy.types.Collection:
    """The collection of a box's photos, made when there is none."""
    for shelf in _collections(scene):
        if shelf[CHOSEN_FOR] == roi:
            return shelf
    shelf = bpy.data.collections.new(f"{roi} Photos")
    shelf[CHOSEN_FOR] = roi
    scene.collection.children.link(shelf)
    return shelf


def _photos(items: Iterable[bpy.types.Object]) -> list[Photo]:
    records = (Photo.from_json(item.roigs.photo) for item in items)
    return [photo for photo in records if photo]


class EditSelection(bpy.types.Operator):
    """Change the active box's list of photos"""

    bl_idname = "roigs.edit_selection"
    bl_label = "Edit Photos"
    bl_options = {"REGISTER", "UNDO"}

    action: EnumProperty(
        items=(
            ("ADD", "Add", "Add the selected cameras"),
            ("REMOVE", "Remove", "Remove the photo from the list"),
            ("UP", "Up", "Move the photo up"),
            ("DOWN", "Down", "Move the photo down"),
            ("CLEAR", "Clear", "Empty the list: the engine will choose"),
        ),
        options=FRESH,
    )
    photo: StringProperty(
        description="ADD: name of the photo; empty: the selected cameras", options=FRESH
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """There must be a box."""
        return available(cls, "" if lookup.active_roi(context) else "Add a ROI first")

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Edit the list and the cameras' colours."""
        roi = lookup.active_roi(context)
        chosen, at = roi.roigs.selection, roi.roigs.selection_index
        match self.action:
            case "ADD":
                self._add(context, chosen)
            case "REMOVE" if at < len(chosen):
                chosen.remove(at)
                roi.roigs.selection_index = max(min(at, len(chosen) - 1), 0)
            case "UP" if 0 < at < len(chosen):
                chosen.move(at, at - 1)
                roi.roigs.selection_index = at - 1
            case "DOWN" if at < len(chosen) - 1:
                chosen.move(at, at + 1)
                roi.roigs.selection_index = at + 1
            case "CLEAR":
                chosen.clear()
                roi.roigs.selected_box = ""
        mark_chosen(context.scene)
        return {"FINISHED"}

    def _add(self, context: bpy.types.Context, chosen) -> None:
        names = [self.photo] if self.photo else []
        if not names:
            names = [photo.name for photo in _photos(context.selected_objects)]
        there = {item.name for item in chosen}
        for name in names:
            if name not in there:
                chosen.add().name = name


CLASSES = (SelectCameras, EditSelection)

register, unregister = bpy.utils.register_classes_factory(CLASSES)
