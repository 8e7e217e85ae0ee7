"""Exporting: the engine writes the Gaussians of a render to one file for other programs."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import bpy

from ..blender import leave_edit_mode, scene_of
from ..engine.own_files import ROIS
from ..engine.writing import writing
from ..errors import AddonError
from ..scene import edits, fly_to, instances
from ..scene.frame_request import Model, models_of, shown, standing
from ..shared import EngineError, files, splat_ply, targets, text
from .spec import EXPORTING, JobSpec

NAME = "roigs-export"
"""Prefix of the list of models and of the log, in Blender's temporary folder."""

PAGE = ".html"
NOTHING = "There is nothing to export: {}."
PLAIN = (".glb", ".usdc", ".usda", ".usdz", ".splat")
"""Formats that cannot store anti-aliasing: the engine makes all Gaussians plain."""
MIXED = (
    "'{}' is made for {}, '{}' for {}: one file cannot contain both. Export each kind "
    "separately, with Selected Only."
)


def spec(
    context: bpy.types.Context,
    path: Path,
    *,
    up: str,
    sh_degree: int,
    selected: bool,
    visible: bool,
) -> JobSpec:
    """Return the job that writes the Gaussians with their present edits and places.

    Args:
        context: gives the scene and the selected objects.
        path: of the file.
        up: axis that points up in the file, as for `convert`; empty for the format's own.
        sh_degree: highest degree of view-dependent colour.
        selected, visible: only objects that are selected, or that the viewport does not hide.

    Raises:
        AddonError: there is nothing to export, an edit cannot be written, some are drawn with
            anti-aliasing and others without, or the folder is missing.
    """
    scene = scene_of(context)
    items, why = _wanted(context, scene, selected=selected, visible=visible)
    leave_edit_mode(items)  # until then, Blender does not give access to the edits
    depsgraph = context.evaluated_depsgraph_get()
    chosen = set(context.selected_objects if selected else scene.objects)
    more = [each for each in instances.instances(depsgraph) if each.instancer in chosen]
    models = _models(items, more, depsgraph, path)
    if not models:
        raise AddonError(NOTHING.format(why))
    if not path.parent.is_dir():
        raise AddonError(f"{path.parent} is not a folder.")
    listed = Path(bpy.app.tempdir) / f"{NAME}.json"
    with writing(listed.parent, "temporary folder in Blender's preferences"):
        page = path.suffix.lower() == PAGE
        photos = fly_to.photos(scene, items) if page else []
        files.write_json(listed, {"models": models, "photos": photos}, durable=False)
        places = fly_to.boxes(items, depsgraph) if page else []
        buttons = listed.with_name(f"{NAME}-{ROIS}")
        if places:
            files.write_json(buttons, {"rois": places}, durable=False)
    options = ["--from-up", "z", "--sh-degree", str(sh_degree)]
    if up:
        options.append(f"--up={up}")  # "-y" would be another option
    if places:
        options += ["--fly-to", str(buttons)]

    def said() -> str:
        size = path.stat().st_size / 1e6
        return f"Exported {path.name}: {text.counted(len(models), 'object')}, {size:.1f} MB"

    return JobSpec(
        title=EXPORTING,
        arguments=["convert", str(listed), str(path), *options],
        log=listed.with_suffix(".log"),
        on_done=said,
        done_text=f"Exported {path.name}",
    )


def _models(
    items: list[bpy.types.Object],
    more: list[instances.Instance],
    depsgraph: bpy.types.Depsgraph,
    path: Path,
) -> list[Model]:
    """Return the models to export to a file.

    Raises:
        AddonError: an edit cannot be written, or they are made for different renderers.
    """
    models = models_of(items, more, depsgraph)
    if problem := edits.problem([*items, *(each.item for each in more)]):
        raise AddonError(problem)
    kinds: dict[targets.Target, str] = {}
    drawn = [item for item, _, _ in standing(items, depsgraph)]
    for item in (*drawn, *(each.item for each in more)):
        if ply := edits.file_of(item):
            with suppress(EngineError):  # the engine reports a missing file
                kinds.setdefault(splat_ply.target_of(ply), item.name)
    lights = {target.linear_light for target in kinds}
    if len(lights if path.suffix.lower() in PLAIN else kinds) > 1:
        (target, name), (other, second) = list(kinds.items())[:2]
        raise AddonError(MIXED.format(name, target.title, second, other.title))
    return models


def _wanted(
    context: bpy.types.Context, scene: bpy.types.Scene, *, selected: bool, visible: bool
) -> tuple[list[bpy.types.Object], str]:
    """Return the objects to export, and the reason if there are none."""
    items, why = shown(scene), "renders show no Gaussians"
    if selected:
        items = [item for item in items if item in context.selected_objects]
        why = "no Gaussians are selected"
    if visible and items:
        items = [item for item in items if item.visible_get(view_layer=context.view_layer)]
        why = why if items else "all are hidden. Show them (Alt H), or turn off Visible Only"
    return items, why
