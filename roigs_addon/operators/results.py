"""Step «Result»: Gaussians in, box by box; renders through the engine."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty

from .. import cameras, facts, jobs, lookup, requests, run_folders, splats
from ..engine.client import Outcome
from ..errors import AddonError, writing
from .base import FRESH, EngineJob, OperatorResult, available, failed

NO_RESULT = "Train first: the run folder holds no result"


class LoadResults(bpy.types.Operator):
    """Bring the trained Gaussians of the run folder into the scene"""

    bl_idname = "roigs.load_results"
    bl_label = "Load Results"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A finished training must be there."""
        there = facts.run(context.scene).result
        return available(cls, "" if there else NO_RESULT)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """One object for the surroundings, two for each box."""
        try:
            splats.show_results(context.scene, run_folders.run_folder(context.scene))
        except AddonError as error:
            return failed(self, error)
        facts.forget()
        return {"FINISHED"}


class SetDetail(bpy.types.Operator):
    """Show this box as it was refined, or as the coarse model has it"""

    bl_idname = "roigs.set_detail"
    bl_label = "Coarse or Fine"
    bl_options = {"REGISTER", "UNDO"}

    roi: StringProperty(description="Name of the box", options=FRESH)
    fine: BoolProperty(default=True, options=FRESH)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Hide one, show the other."""
        splats.set_detail(context.scene, self.roi, self.fine)
        return {"FINISHED"}


class ShowPoints(bpy.types.Operator):
    """Show the Gaussians as points, or as what they are"""

    bl_idname = "roigs.show_points"
    bl_label = "Points or Gaussians"

    points: BoolProperty(default=True, options=FRESH)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """For all of the scene's."""
        splats.set_points(context.scene, self.points)
        jobs.redraw()
        return {"FINISHED"}


class RenderSplats(EngineJob, bpy.types.Operator):
    """Render the trained scene through the active camera with the engine's own rasterizer"""

    bl_idname = "roigs.render"
    bl_label = "Render Gaussians"

    animation: BoolProperty(
        name="Animation", description="All frames of the scene's range", options=FRESH
    )
    directory: StringProperty(
        name="Folder",
        subtype="DIR_PATH",
        description="Where pictures go (empty: the run folder)",
        options=FRESH,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A camera, a result, and an engine at rest."""
        reason = ""
        if jobs.busy():
            reason = "The engine is busy"
        elif not facts.run(context.scene).result:
            reason = NO_RESULT
        elif context.scene.camera is None:
            reason = "The scene has no active camera"
        return available(cls, reason)

    def work(self, context: bpy.types.Context) -> jobs.Work:
        """A camera path for the engine; the pictures come back as images."""
        scene = context.scene
        folder = run_folders.run_folder(scene)
        out = Path(bpy.path.abspath(self.directory)) if self.directory else folder / "renders"
        path = folder / "blender" / "path.json"
        frames = self._frames(scene)
        with writing(folder, "Run Folder"):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps({"cameras": frames}), encoding="utf-8")

        def take(_: Outcome) -> None:
            picture = out / f"{frames[0]['name']}.png"
            if picture.is_file():
                image = bpy.data.images.load(str(picture), check_existing=True)
                image.reload()

        return jobs.Work(
            title="Rendering",
            arguments=[
                "render",
                str(folder / "result.ply"),
                "--path",
                str(path),
                "--out",
                str(out),
                *requests.machine_options(),
            ],
            log=folder / "blender" / "engine.log",
            on_done=take,
        )

    def _frames(self, scene: bpy.types.Scene) -> list[dict[str, object]]:
        """The active camera at each frame, as a camera path (docs/files.md)."""
        now = scene.frame_current
        numbers = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
        frames = []
        for number in numbers if self.animation else [now]:
            if number != scene.frame_current:
                scene.frame_set(number)
            photo = cameras.scene_camera(scene, scene.roigs.root)
            if photo is None:
                scene.frame_set(now)
                raise AddonError("The active camera is not a perspective camera. Set its type.")
            frames.append(json.loads(photo.to_json()))
        if scene.frame_current != now:
            scene.frame_set(now)
        return frames


def box_levels(scene: bpy.types.Scene) -> dict[str, bool]:
    """Box -> whether its refined Gaussians are the ones that show."""
    return {
        item.roigs.roi: not item.hide_get()
        for item in lookup.splats(scene)
        if item.roigs.level == "ROI"
    }


CLASSES = (LoadResults, SetDetail, ShowPoints, RenderSplats)

register, unregister = bpy.utils.register_classes_factory(CLASSES)
