"""What commands find themselves: a COLMAP project of photos, and the box of `--roi auto`."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..context import Context
from ..errors import ConfigError
from ..formats import run_files
from ..formats.files import write_text
from ..formats.projects import model_folders, model_suffix, project_folder
from ..formats.rois import rois_document
from ..formats.text import counted
from ..model.roi import OrientedBox, load_rois
from ..model.scene import SfmScene
from ..photos.files import EXTENSIONS, HEIC, PhotoFolder
from .console import Console
from .options import AUTO, boxes, mask_options, only


def is_auto(args: argparse.Namespace) -> bool:
    """Whether the scene tells the box; ConfigError if other boxes are given too."""
    if AUTO in args.roi and (args.rois or len(args.roi) > 1):
        raise ConfigError(f"--roi {AUTO} stands for all boxes.", "Give it, or boxes.")
    return AUTO in args.roi


def boxes_of(args: argparse.Namespace, scene: SfmScene, folder: Path | None) -> list[OrientedBox]:
    """The boxes of the options. That of `--roi auto` is read from the folder, if it is there.

    Raises:
        RoiError: as `boxes`, `read_rois` and `automatic_box`.
    """
    from ..model.roi import automatic_box

    if not is_auto(args):
        return boxes(args)
    path = folder and folder / run_files.BOXES
    return only(load_rois(path) if path and path.exists() else [automatic_box(scene)], args)


def box_names(args: argparse.Namespace, folder: Path | None) -> list[str]:
    """The names of `boxes_of`, which are known before the scene; raises as that."""
    from ..model.roi import AUTOMATIC_NAME

    if not is_auto(args):
        return [roi.name for roi in boxes(args)]
    path = folder and folder / run_files.BOXES
    return [roi.name for roi in load_rois(path)] if path and path.exists() else [AUTOMATIC_NAME]


def keep_box(
    args: argparse.Namespace, rois: list[OrientedBox], folder: Path | None, context: Context
) -> None:
    """Write the box of `--roi auto` to the folder, where a person can change it, and say so.

    From then on, the options name that file.
    """
    if not is_auto(args):
        return
    path = folder and folder / run_files.BOXES
    found = path is None or not path.exists()
    for roi in rois:
        sides = " x ".join(f"{2 * side:.3g}" for side in roi.half_extents)
        place = ", ".join(f"{value:.3g}" for value in roi.centre)
        how = "around what most photos show" if found else f"from {path}"
        context.info(f"Box '{roi.name}' {how}: {sides}, centre {place}.")
    if path is None:
        return
    if found:
        write_text(path, rois_document(rois))
        context.info(f"To change the box, edit {path}; to find it anew, delete that file.")
    args.rois, args.roi = path, []


def is_photos(scene: Path) -> bool:
    """Whether the scene is a folder of photos without a COLMAP model, or a video."""
    from ..formats.projects import is_video

    if is_video(scene):
        return True
    if not scene.is_dir() or model_folders(project_folder(scene)):
        return False
    return _count(scene) > 0


def _count(folder: Path) -> int:
    """The number of photos below a folder."""
    return len(PhotoFolder(folder, EXTENSIONS | HEIC).others([]))


def project_of(args: argparse.Namespace) -> Path:
    """The COLMAP project that photos become."""
    folder: Path = args.run_dir / run_files.PROJECT
    return folder


def check_photos(args: argparse.Namespace) -> bool:
    """Whether the scene is photos.

    Raises:
        ConfigError: the run folder is among them, or boxes are given before there is a model.
    """
    if not is_photos(args.scene):
        return False
    if args.run_dir.resolve().is_relative_to(args.scene.resolve()):
        raise ConfigError(
            f"{args.run_dir} is in the folder of the photos.", "Choose another --run-dir."
        )
    if not is_auto(args) and not model_suffix(project_of(args) / "sparse/0"):
        raise ConfigError(
            f"{args.scene} has no COLMAP model, so boxes have no coordinates yet.",
            f'Use --roi {AUTO} instead of boxes (roi = ["{AUTO}"] in a table), or make the model'
            " first (`reconstruct`).",
        )
    return True


def reconstructed(args: argparse.Namespace, console: Console) -> None:
    """Make the photos a COLMAP project in the run folder, or resume that; it becomes the scene.

    Raises:
        As `reconstruct`.
    """
    from ..reconstruction.reconstruct import reconstruct
    from ..reconstruction.settings import Settings

    out = project_of(args)
    console.context.info(f"{args.scene} has no COLMAP model; {out} gets one.")
    masks = mask_options(args)
    masks.check()
    reconstruct(args.scene, out, Settings(), args.threads, console.context, masks=masks)
    args.scene = out


def photos_plan(args: argparse.Namespace) -> str:
    """What a run of photos does that have no model yet."""
    photos = counted(_count(args.scene), "photo") if args.scene.is_dir() else str(args.scene)
    return "\n".join(
        [
            f"Plan of {args.run_dir}: preset {args.preset}",
            f"1. Make a COLMAP project from {photos} in {project_of(args)}",
            f"2. Put a box around what most photos show: {args.run_dir / run_files.BOXES}",
            "3. Train. Stages, memory and minutes can be told after step 1, which is",
            f"   python -m roigs_engine reconstruct {args.scene} --out {project_of(args)}",
        ]
    )
