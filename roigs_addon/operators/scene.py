"""Step «Scene»: a COLMAP model comes in; its cameras become the scene's."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path

import bpy
from bpy.props import BoolProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from .. import cameras, importing, jobs, lookup, preferences, run_folders
from ..engine.client import Outcome
from ..engine.python import FOR_READING
from ..errors import AddonError, writing
from ..photo import Photo
from .base import FRESH, EngineJob, OperatorResult, failed
from .select import mark_chosen


class ImportColmap(EngineJob, bpy.types.Operator, ImportHelper):
    """Import the cameras, photos and points of a COLMAP model"""

    bl_idname = "roigs.import_colmap"
    bl_label = "Import COLMAP"
    packages = FOR_READING

    directory: StringProperty(subtype="DIR_PATH", options=FRESH)
    filepath: StringProperty(subtype="FILE_PATH", options=FRESH)
    images: StringProperty(
        name="Photos",
        subtype="DIR_PATH",
        description="Folder of the photos (empty: found)",
        options=FRESH,
    )
    filter_folder: BoolProperty(default=True, options={"HIDDEN", *FRESH})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """One job at a time."""
        if jobs.busy():
            cls.poll_message_set("The engine is busy")
        return not jobs.busy()

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> OperatorResult:
        """Ask for the folder, unless it was given; the file browser then calls `execute`."""
        if self.directory or self.filepath:
            return EngineJob.invoke(self, context, event)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Wait for the end in a script; leave the window to its user after the file browser."""
        if bpy.app.background or not self.options.is_invoke:
            return EngineJob.execute(self, context)
        try:
            jobs.start(preferences.engine(self.packages), self.work(context))
        except AddonError as error:
            return failed(self, error)
        return {"FINISHED"}

    def work(self, context: bpy.types.Context) -> jobs.Work:
        """Export the model to the cache, then build objects from that."""
        folder = Path(bpy.path.abspath(self.directory or self.filepath))
        if folder.is_file():
            folder = folder.parent
        if not folder.is_dir():
            raise AddonError(f"There is no folder {folder}. Choose the folder of a COLMAP project.")
        out = export_folder(folder)
        with writing(out, "Cache Folder in the add-on's preferences"):
            out.mkdir(parents=True, exist_ok=True)
        find, images = run_folders.finder(context.scene), self.images
        arguments = ["export", str(folder), "--out", str(out)]
        if images:
            arguments += ["--images", bpy.path.abspath(images)]

        def build(_: Outcome) -> None:
            scene = find()
            if scene is None:
                return
            counts = importing.import_folder(scene, out, project_name(folder))
            mark_chosen(scene)
            _without_parent_lines()
            scene.roigs.colmap, scene.roigs.images = str(folder), images
            skipped = f"; left out: {scene.roigs.skipped}" if scene.roigs.skipped else ""
            text = f"{counts['photos']:,} photos, {counts['points']:,} points{skipped}"
            bpy.context.window_manager.roigs.message = text

        return jobs.Work(
            title="Importing", arguments=arguments, log=out / "engine.log", on_done=build
        )


def _without_parent_lines() -> None:
    """In the 3D views: a line from each of a thousand cameras to the root hides everything."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.spaces.active.overlay.show_relationship_lines = False


def project_name(folder: Path) -> str:
    """What a COLMAP project is called: its folder's name, but for `sparse` and `sparse/0`."""
    while folder.parent.name and (folder.name == "sparse" or folder.parent.name == "sparse"):
        folder = folder.parent
    return folder.name


def export_folder(colmap: Path) -> Path:
    """Where a model's exported files lie: a folder of the cache for each path."""
    key = hashlib.sha256(str(colmap.resolve()).encode()).hexdigest()[:16]
    return preferences.models_folder() / key


class LookThrough(bpy.types.Operator):
    """Make this photo's camera the active one, with its resolution and its photo behind it"""

    bl_idname = "roigs.look_through"
    bl_label = "Look Through"
    bl_options = {"REGISTER", "UNDO"}

    photo: StringProperty(
        description="Name of the photo; empty: the active object's, else the active camera's",
        options=FRESH,
    )
    step: IntProperty(description="Go so many photos on from that one", default=0, options=FRESH)

    def execute(self, context: bpy.types.Context) -> OperatorResult:
        """Activate the camera and look through it."""
        item = self._camera(context)
        if item is None:
            return failed(self, AddonError(self._missing(context)))
        cameras.activate(context.scene, item)
        if lookup.camera_at_hand(context) != item:  # another photo's camera is the active object
            with suppress(RuntimeError):  # not an object of this view layer
                context.view_layer.objects.active = item
        space = context.space_data
        if space is not None and space.type == "VIEW_3D":
            space.region_3d.view_perspective = "CAMERA"
        return {"FINISHED"}

    def _missing(self, context: bpy.types.Context) -> str:
        if not lookup.cameras(context.scene):
            return "There are no photos. Import a COLMAP model first."
        if self.photo:
            return "There is no such photo. Photos are named as in the COLMAP model."
        return "Select the camera of a photo first."

    def _camera(self, context: bpy.types.Context) -> bpy.types.Object | None:
        found = lookup.cameras(context.scene)
        if self.photo:
            return found.get(self.photo)
        if self.step and found:
            names = sorted(found)
            active = lookup.camera_at_hand(context)
            photo = Photo.from_json(active.roigs.photo) if active else None
            at = names.index(photo.name) + self.step if photo and photo.name in names else 0
            return found[names[at % len(names)]]
        return lookup.camera_at_hand(context)


def menu_entry(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """File ▸ Import."""
    menu.layout.operator(ImportColmap.bl_idname, text="COLMAP (ROI-GS)")


CLASSES = (ImportColmap, LookThrough)


def register() -> None:
    """Classes and the menu entry."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.TOPBAR_MT_file_import.append(menu_entry)


def unregister() -> None:
    """The reverse."""
    bpy.types.TOPBAR_MT_file_import.remove(menu_entry)
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
