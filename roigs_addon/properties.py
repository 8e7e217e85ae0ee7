"""The add-on's data in a .blend file: one group per scene, one per object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from .engine.presets import PRESETS, follow_preset
from .shared import choices, declare, project_requests, run_requests, targets, values
from .stage_properties import RoigsStage

KINDS = (
    ("NONE", "None", "Not an object of ROI-GS"),
    ("ROOT", "Root", "Parent of everything that belongs to an imported COLMAP model"),
    ("CAMERA", "Photo", "A photo of the COLMAP model"),
    ("POINTS", "Points", "The sparse points of the COLMAP model"),
    ("ROI", "Box", "A box (ROI, region of interest) around something to sharpen"),
    ("SPLATS", "Gaussians", "Trained Gaussians"),
    ("SURFACE", "Mesh", "The surface of a box, as a mesh with the photos' texture"),
    ("PROXY", "Proxy", "Proxy of a captured surface, for shadows and reflections in renders"),
    ("SHOT", "Suggested Photo", "Where a photo should be taken"),
)
RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5, 0) else set()
"""For a path that may begin with `//`; earlier Blenders need no such option."""

LEVELS = (
    ("RESULT", "Result", "Scene and boxes"),
    ("SCENE", "First Pass", "The whole-scene model, before the boxes were refined"),
    ("ROI", "Box", "The refined Gaussians of a box"),
    ("PREVIEW", "Preview", "The model in training"),
    ("IMPORTED", "Imported", "A file of Gaussians that the user imported"),
)

SHOWN_AS = (
    ("GAUSSIANS", "Gaussians", "Blender's own splats, from version 5.3 on; before, the exact look"),
    ("EXACT", "Exact Look", "Drawn by ROI-GS, as they were trained"),
    ("POINTS", "Points", "A point for each Gaussian"),
)


MOST = (1 << 31) - 1  # that Blender's integers hold


def setting(kind: Any, option: str, request: type[Any] = run_requests.Train, **more: Any) -> Any:
    """A property for an option of the engine, which tells name, description, range and default.

    Args:
        kind: of property.
        option: its name in the request.
        request: that has it.
        more: what the option does not tell, or what is different in Blender.
    """
    known = declare.options_of(request)[option]
    facts: dict[str, Any] = {"name": known.label, "description": known.tooltip}
    if isinstance(known.kind, values.Number):
        low = 0 if known.kind.zero else known.kind.low
        number = int if known.kind.integer else float
        facts |= {"min": number(low), "max": number(min(known.kind.high, MOST))}
    if known.default is not None:
        facts["default"] = known.default
    return kind(**(facts | more))


def zero(number: str, otherwise: int, **more: Any) -> Any:
    """A property that is true while `number` is 0; switched off, it makes it `otherwise`."""

    def switch(props: Any, on: bool) -> None:
        setattr(props, number, 0 if on else otherwise)

    return BoolProperty(get=lambda props: getattr(props, number) == 0, set=switch, **more)


class RoigsPhotoItem(bpy.types.PropertyGroup):
    """A selected photo; `name` (every property group has one) is the photo's."""

    score: FloatProperty(description="Coverage of the box by the photos up to this one")


class RoigsScribble(bpy.types.PropertyGroup):
    """A person's strokes for a box on a photo; `name` is the photo's."""

    strokes: StringProperty(description="JSON list, as in a file of scribbles; oldest first")


class RoigsExcludedPhoto(bpy.types.PropertyGroup):
    """A photo that is not used; `name` is the photo's."""


class RoigsEditedMesh(bpy.types.PropertyGroup):
    """Edited points of a result that is not shown."""

    mesh: PointerProperty(type=bpy.types.Mesh)


def _half_sides(props: RoigsObject) -> list[float]:
    """A box's half sides below its parent: scripts and older files have them in `scale`."""
    item: Any = props.id_data
    size = item.empty_display_size
    return [abs(a * b) * size for a, b in zip(item.scale, item.delta_scale, strict=True)]


def _set_half_sides(props: RoigsObject, sides: Sequence[float]) -> None:
    """The largest into `scale`, the proportions into `delta_scale`.

    Blender 5.2 warns of an object whose `scale` is uneven, and View Selected frames an empty by its
    `scale` alone.
    """
    item: Any = props.id_data
    largest = max(sides) or 1.0
    item.delta_scale = [side / largest for side in sides]
    item.scale = [largest / item.empty_display_size] * 3


def _look_again(props: bpy.types.PropertyGroup, _: bpy.types.Context) -> None:
    """Exports read evaluated objects, and Blender does not see a script's change by itself."""
    owner = props.id_data
    assert owner is not None
    owner.update_tag()


class RoigsObject(bpy.types.PropertyGroup):
    """The add-on's data on an object. Only the fields of its kind are used."""

    kind: EnumProperty(items=KINDS, default="NONE")
    photo: StringProperty(description="Photo: its record, see geometry/photo.py")
    suggestion: StringProperty(description="Suggested photo: its number and gain, as JSON")
    selection: CollectionProperty(type=RoigsPhotoItem, description="Box: its photos, best first")
    selection_index: IntProperty(description="Box: the photo that is active in the list")
    scribbles: CollectionProperty(type=RoigsScribble, description="Box: strokes on photos")
    half_sides: FloatVectorProperty(
        name="Half Side",
        subtype="XYZ_LENGTH",
        size=3,
        min=0.0,
        precision=4,
        get=_half_sides,
        set=_set_half_sides,
        description="Box: half its sides below its parent",
    )
    selected_box: StringProperty(description="Box: where it was when its photos were selected")
    checked: StringProperty(description="Box: what its photos show, as JSON")
    ply: StringProperty(description="Gaussians: their file", subtype="FILE_PATH")
    level: EnumProperty(items=LEVELS, description="Gaussians: the model they belong to")
    shown_as: EnumProperty(items=SHOWN_AS, description="Gaussians: how they are drawn")
    exact_for: StringProperty(
        description="Gaussians: Blender's own splats, in the exact look as long as this is there"
    )
    roi: StringProperty(description="Gaussians, mesh: name of their box")
    result_mark: StringProperty(description="Gaussians, mesh: mark of the result they belong to")
    surface: StringProperty(description="Mesh: the engine's record of it, as JSON")
    parked: StringProperty(
        description="Gaussians: hidden, as they are not in the shown result; earlier visibility"
    )
    off: BoolProperty(
        description="Gaussians: hidden, as the other of Result and First Pass is shown"
    )
    stands_on: FloatVectorProperty(
        default=(0.0, 0.0, 1.0),
        description="User's objects: normal of the surface they were last put on",
    )
    whole: BoolProperty(description="Gaussians: always draw all, without levels of detail")
    pair: StringProperty(description="Gaussians: key shared by Result and First Pass of one box")
    waits: BoolProperty(description="Gaussians: hidden while a preview is shown")
    beside: StringProperty(
        description="Gaussians, mesh: hidden, as a mesh is shown alone; earlier visibility"
    )
    aside: CollectionProperty(
        type=RoigsEditedMesh, description="Gaussians: edits of results that are not shown"
    )
    exposure: FloatProperty(
        name="Exposure",
        default=0.0,
        min=-16.0,
        max=16.0,
        soft_min=-3.0,
        soft_max=3.0,
        precision=2,
        update=_look_again,
        description="Gaussians: in stops; 1 doubles the colours' sRGB values, -1 halves them",
    )
    tint: FloatVectorProperty(
        name="Tint",
        subtype="COLOR_GAMMA",
        size=3,
        default=(1.0, 1.0, 1.0),
        min=0.0,
        max=16.0,
        soft_max=1.0,
        update=_look_again,
        description="Gaussians: multiplies their colours; white changes nothing",
    )


USUAL_TARGET = (targets.CYCLES if bpy.app.version >= (5, 3, 0) else targets.VIEWERS).name
"""What a result is made for: from 5.3 on, Blender has splats of its own."""


def _follow_preset(settings: RoigsScene, _: bpy.types.Context) -> None:
    follow_preset(settings, USUAL_TARGET)


def _other_photos(settings: RoigsScene, _: bpy.types.Context) -> None:
    """Other photos get another project folder, and other masks."""
    settings.project = settings.masks = ""


class RoigsScene(bpy.types.PropertyGroup):
    """Photos and settings of a scene's training."""

    stage: PointerProperty(type=RoigsStage)

    photos: StringProperty(
        name="Photos",
        subtype="DIR_PATH",
        options=RELATIVE,
        update=_other_photos,
        description="Folder of the photos to reconstruct, or a video",
    )
    project: StringProperty(
        name="Project Folder",
        subtype="DIR_PATH",
        options=RELATIVE,
        description="Folder for the COLMAP project of the photos; an unfinished one is resumed"
        " (empty: beside the photos)",
    )
    masks: StringProperty(
        name="Masks",
        subtype="DIR_PATH",
        options=RELATIVE,
        description="Folder of masks, NAME.png for the photo NAME; black areas get no features "
        "(empty: the folder masks beside the photos, if there is one)",
    )
    feature_side: setting(IntProperty, "max_side", project_requests.Reconstruct, subtype="PIXEL")
    pairs: setting(EnumProperty, "pairs", project_requests.Reconstruct, items=choices.PAIR_ITEMS)
    shared_cameras: setting(
        EnumProperty, "cameras", project_requests.Reconstruct, items=choices.CAMERA_ITEMS
    )

    root: PointerProperty(
        type=bpy.types.Object,
        name="Root",
        description="Empty that is the parent of the COLMAP model",
    )
    colmap: StringProperty(
        name="COLMAP", subtype="DIR_PATH", description="Folder of the COLMAP project"
    )
    images: StringProperty(
        name="Photos",
        subtype="DIR_PATH",
        description="Folder of the photos (empty: found automatically)",
    )
    run_dir: StringProperty(
        name="Run Folder",
        subtype="DIR_PATH",
        options=RELATIVE,
        description="Where training keeps its files (empty: chosen when the first job starts)",
    )
    active_roi: PointerProperty(type=bpy.types.Object, name="Active Box")
    method: setting(EnumProperty, "method", items=choices.METHOD_ITEMS, default="coverage")
    count: setting(IntProperty, "count", min=0, default=0)
    all_useful: zero(
        "count",
        20,
        name="As many as help",
        description="Select photos until more do not help. Switch off to choose their number",
    )
    suggested: setting(IntProperty, "count", project_requests.Suggest, default=8)
    seed: setting(IntProperty, "seed", default=0)
    preset: setting(EnumProperty, "preset", items=PRESETS, update=_follow_preset)
    is_paper: BoolProperty(description="Whether the settings followed the paper's preset last")
    strategy: setting(EnumProperty, "strategy", items=choices.STRATEGY_ITEMS, default="joint")
    steps_factor: setting(FloatProperty, "steps_factor", default=1.0, min=0.001, soft_max=10.0)
    made_for: setting(EnumProperty, "made_for", items=choices.MADE_FOR_ITEMS, default=USUAL_TARGET)
    max_side: setting(
        IntProperty, "max_side", default=640, soft_min=64, soft_max=16384, subtype="PIXEL"
    )
    test_every: setting(IntProperty, "test_every", default=0)
    no_tests: zero(
        "test_every",
        8,
        name="None",
        description="Train on all photos. Switch off to keep some, and measure the result on them",
    )
    excluded: CollectionProperty(
        type=RoigsExcludedPhoto, description="Photos excluded from selection and training"
    )
    model_cache: StringProperty(description="Folder of the model as exported by the engine")
    skipped: StringProperty(description="Photos and points that the import skipped, in words")
    show_masks: BoolProperty(
        name="Show Masks",
        description="Show the photo with the active box's strokes and mask, in a view through a"
        " photo's camera",
        default=False,
    )
    compare_photo: BoolProperty(
        name="Compare",
        default=True,
        update=_look_again,
        description="In a view through a photo's camera, show the photo left of a line, the "
        "Gaussians right of it. Off: the photo is behind the Gaussians",
    )
    wipe: FloatProperty(
        name="Photo",
        subtype="FACTOR",
        default=0.5,
        min=0.0,
        max=1.0,
        precision=2,
        description="Share of the view that shows the photo. Or drag the line in the view",
    )
    known_length: FloatProperty(
        name="Length",
        default=1.0,
        min=1e-6,
        soft_min=1e-3,
        soft_max=100.0,
        precision=4,
        subtype="DISTANCE",
        description="Known distance between two points, for Set Scale",
    )
    placement: StringProperty(
        description="Text of the placement file beside the model, when it was last written"
    )
    has_floor: BoolProperty(description="Whether the floor was put at z = 0")
    placement_key: StringProperty(description="Place of the root at that time")
    result_mark: StringProperty(description="Mark of this scene's own result, see ownership.py")
    compared: StringProperty(description="Folder of the earlier result that was shown last")
    carry_colour: BoolProperty(
        name="View-Dependent Colour in the .blend",
        default=True,
        description="Save the view-dependent colour in the .blend, which is then three times as"
        " large (57 MB instead of 20 MB for 200,000 Gaussians). Without it, the colour comes from"
        " the PLY files; if they are gone, colours look the same from all sides",
    )
    watertight: setting(BoolProperty, "watertight", run_requests.MakeSurface)
    faces: setting(IntProperty, "faces", run_requests.MakeSurface, soft_max=1_000_000)
    texture_size: setting(
        IntProperty, "texture_size", run_requests.MakeSurface, min=0, default=0, subtype="PIXEL"
    )
    fine_texture: zero(
        "texture_size",
        2048,
        name="As the photos",
        description="Match the texture to the photos' resolution on the object. Switch off to "
        "choose its size",
    )
    use_levels: BoolProperty(
        name="Levels of Detail",
        default=True,
        description="Draw fewer Gaussians for distant parts, in the 3D view and in renders",
    )
    level_quality: FloatProperty(
        name="Quality",
        default=1.0,
        min=0.25,
        max=4.0,
        precision=2,
        description="A higher value keeps finer levels longer; 1 switches to a coarser one where"
        " the difference is hardly visible",
    )


def scene_props(scene: bpy.types.Scene) -> RoigsScene:
    """The add-on's settings of a scene."""
    described: Any = scene  # Blender's stubs know nothing of what add-ons add
    group: RoigsScene = described.roigs
    return group


def object_props(item: bpy.types.Object) -> RoigsObject:
    """The add-on's data on an object."""
    described: Any = item
    group: RoigsObject = described.roigs
    return group


# Blender's stubs know neither what add-ons add to its types nor what this returns.
OWNERS: Any = bpy.types
DEFINE: Any = PointerProperty
CLASSES = (
    RoigsPhotoItem,
    RoigsScribble,
    RoigsExcludedPhoto,
    RoigsEditedMesh,
    RoigsObject,
    RoigsStage,
    RoigsScene,
)


def register() -> None:
    """Register the classes first, then the pointers to them."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    OWNERS.Scene.roigs = DEFINE(type=RoigsScene)
    OWNERS.Object.roigs = DEFINE(type=RoigsObject)


def unregister() -> None:
    """Remove everything that `register` made."""
    del OWNERS.Object.roigs, OWNERS.Scene.roigs
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
