"""What the add-on keeps in a .blend file: one group per scene, one per object."""

from __future__ import annotations

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

KINDS = (
    ("NONE", "None", "Not of ROI-GS"),
    ("ROOT", "Root", "What an imported COLMAP model hangs on"),
    ("CAMERA", "Photo", "A photo of the COLMAP model"),
    ("POINTS", "Points", "The sparse points of the COLMAP model"),
    ("ROI", "ROI", "A box around an object of interest"),
    ("SPLATS", "Gaussians", "Gaussians that were trained"),
)
METHODS = (
    ("coverage", "Coverage", "Photos that together show the box from all sides, near and large"),
    ("gp9", "Gaussian process (paper)", "Best by a Gaussian process over nine view parameters"),
    ("gp6", "Gaussian process, 6", "Best by a Gaussian process over six view parameters"),
    ("greedy", "Greedy", "Always the photo that raises the score most"),
    ("static", "Static", "Photos ranked once by distance, size and points"),
    ("fvs", "Farthest views", "Viewpoints as far from each other as they can be"),
    ("random", "Random", "For comparison"),
)
PRESETS = (
    ("draft", "Draft", "5,000 steps: minutes on a CPU"),
    ("standard", "Standard", "15,000 steps"),
    ("paper", "Paper", "50,000 steps, boxes one by one, photos by the paper's Gaussian process"),
)
STRATEGIES = (
    ("joint", "All boxes together", "One stage for all boxes that goes on with the whole scene"),
    ("independent", "One by one (paper)", "A model per box, which then replaces the coarse one"),
)
RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5, 0) else set()
"""Of a path that may begin with «//»; earlier Blenders do not ask for it."""

PAPERS_WAY = {"strategy": "independent", "method": "gp9"}
OUR_WAY = {"strategy": "joint", "method": "coverage"}
LEVELS = (
    ("RESULT", "Result", "Scene and boxes"),
    ("SCENE", "Coarse", "Scene-GS, before the boxes were refined"),
    ("ROI", "Box", "The refined Gaussians of one box"),
    ("PREVIEW", "Preview", "The model in training"),
)


class RoigsPhotoItem(bpy.types.PropertyGroup):
    """A chosen photo; `name`, which every property group has, is the photo's."""

    score: FloatProperty(description="How well the box is covered by the photos up to this one")


class RoigsObject(bpy.types.PropertyGroup):
    """What an object is to the add-on. Only the fields of its kind are in use."""

    kind: EnumProperty(items=KINDS, default="NONE")
    photo: StringProperty(description="Photo: its record, see photo.py")
    selection: CollectionProperty(type=RoigsPhotoItem, description="ROI: its photos, best first")
    selection_index: IntProperty(description="ROI: the photo that is active in the list")
    selected_box: StringProperty(description="ROI: the box that the photos were selected for")
    ply: StringProperty(description="Gaussians: their file", subtype="FILE_PATH")
    level: EnumProperty(items=LEVELS, description="Gaussians: which model they are from")
    as_points: BoolProperty(description="Gaussians: the viewport shows points in their place")
    roi: StringProperty(description="Gaussians: name of the box they are in")


def _follow_preset(settings: RoigsScene, _: bpy.types.Context) -> None:
    """The paper's way comes and goes with its preset; what was chosen by hand stays."""
    left, taken = OUR_WAY, PAPERS_WAY
    if settings.preset != "paper":
        left, taken = PAPERS_WAY, OUR_WAY
    for name, value in taken.items():
        if getattr(settings, name) == left[name]:
            setattr(settings, name, value)


class RoigsScene(bpy.types.PropertyGroup):
    """The job that this scene describes."""

    root: PointerProperty(
        type=bpy.types.Object, name="Root", description="Empty that the COLMAP model hangs on"
    )
    colmap: StringProperty(
        name="COLMAP", subtype="DIR_PATH", description="Folder of the COLMAP project"
    )
    images: StringProperty(
        name="Photos", subtype="DIR_PATH", description="Folder of the photos (empty: found)"
    )
    run_dir: StringProperty(
        name="Run Folder",
        subtype="DIR_PATH",
        options=RELATIVE,
        description="Where training keeps its work (empty: chosen at the first job)",
    )
    active_roi: PointerProperty(type=bpy.types.Object, name="Active ROI")
    method: EnumProperty(items=METHODS, name="Method", default="coverage")
    count: IntProperty(
        name="Photos",
        default=0,
        min=0,
        description="How many photos each box gets; 0: as many as the method finds useful",
    )
    seed: IntProperty(name="Seed", default=0, min=0, description="Of everything random")
    preset: EnumProperty(items=PRESETS, name="Preset", default="draft", update=_follow_preset)
    strategy: EnumProperty(items=STRATEGIES, name="Boxes", default="joint")
    steps_factor: FloatProperty(
        name="Steps",
        default=1.0,
        min=0.001,
        max=1000.0,
        soft_max=10.0,
        description="Times the preset's steps: less is faster, more is finer",
    )
    max_side: IntProperty(
        name="Photo Size",
        default=640,
        min=1,
        soft_min=64,
        max=1 << 20,
        soft_max=16384,
        subtype="PIXEL",
        description="Longest side of the photos in training; larger shows more and takes longer",
    )
    test_every: IntProperty(
        name="Keep for Tests",
        default=0,
        min=0,
        description="Every n-th photo of a box is kept out of training, to measure with; 0: none",
    )
    model_cache: StringProperty(description="Folder of the model as the engine exported it")
    skipped: StringProperty(description="What the import left out, in words")


class RoigsRunState(bpy.types.PropertyGroup):
    """What the panel shows of the engine; on the window manager, which is never saved."""

    title: StringProperty()
    stage: StringProperty()
    step: IntProperty()
    total: IntProperty()
    loss: FloatProperty()
    psnr: FloatProperty()
    gaussians: IntProperty()
    seconds_left: FloatProperty()
    message: StringProperty()
    error: StringProperty()
    log: StringProperty()


CLASSES = (RoigsPhotoItem, RoigsObject, RoigsScene, RoigsRunState)


def register() -> None:
    """Classes first, then the pointers to them."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.roigs = PointerProperty(type=RoigsScene)
    bpy.types.Object.roigs = PointerProperty(type=RoigsObject)
    bpy.types.WindowManager.roigs = PointerProperty(type=RoigsRunState, options={"SKIP_SAVE"})


def unregister() -> None:
    """Everything `register` made."""
    del bpy.types.WindowManager.roigs, bpy.types.Object.roigs, bpy.types.Scene.roigs
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
