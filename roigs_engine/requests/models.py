"""Requests for trained models: pictures, file formats, objects, masks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..formats.run_files import BACKGROUND, FINE
from . import choices
from .declare import Request, option
from .groups import MODEL, Boxes, Device, Photos, PhotoSize, Scene, Threads
from .values import FLAG, NAME, PATH, Choice, Number, integer


@dataclass(frozen=True, kw_only=True)
class Render(PhotoSize, Device):
    """Pictures of a PLY from the cameras of a COLMAP model, or along a camera path."""

    ply: Path = option(PATH, "PLY to render", required=True, flags=())
    scene: Path | None = option(
        PATH, "COLMAP project with the cameras", metavar="DIR", excludes="cameras!"
    )
    path: Path | None = option(
        PATH,
        "camera path, a JSON file (docs/files.md); --downscale and --max-side apply to it",
        metavar="FILE",
        excludes="cameras!",
    )
    name: tuple[str, ...] = option(
        NAME, "render only the camera of this name; repeatable", repeat=True
    )
    levels: bool = option(
        FLAG, "draw the result of a run in its levels of detail, as its levels.json says", False
    )
    quality: float = option(
        Number(low=0.01, high=100),
        "with --levels: how many times finer they shall be (default: {default})",
        1.0,
        metavar="Q",
    )
    out: Path = option(PATH, "folder for the pictures", required=True, metavar="DIR")


@dataclass(frozen=True, kw_only=True)
class RenderFrames(Threads, Device):
    """Pictures for compositing, as another program asks for them."""

    folder: Path = option(
        PATH, "folder of the requests, JSON files (docs/files.md)", required=True, flags=()
    )
    once: bool = option(FLAG, "end when no request is left", False)


@dataclass(frozen=True, kw_only=True)
class Compose(Boxes):
    """A scene's Gaussians in boxes replaced by those of object models."""

    scene_ply: Path = option(PATH, "PLY of the whole scene", required=True, flags=())
    object: tuple[str, ...] = option(
        NAME,
        "PLY whose Gaussians in the box replace the scene's; repeatable",
        required=True,
        repeat=True,
        metavar="ROI=FILE.ply",
    )
    out: Path = option(PATH, "PLY to write", required=True, metavar="FILE")


@dataclass(frozen=True, kw_only=True)
class _Page(Request, heading="web page (OUT.html)"):
    """What a page shows besides the model."""

    title: str | None = option(NAME, "of the page (default: the name of OUT)", metavar="TEXT")
    fly_to: Path | None = option(
        PATH, "rois.json: a button for each box, which flies there; crops nothing", metavar="FILE"
    )
    before: Path | None = option(
        PATH, "a second model, to switch between before/after", metavar="FILE"
    )
    page_scene: Path | None = option(
        PATH,
        "COLMAP project that IN was trained on: its photos tell which way is up, and from where to"
        " look first (default: that of IN's run folder, if it has one); also for --plain",
        metavar="DIR",
        flags=("--scene",),
    )


@dataclass(frozen=True, kw_only=True)
class Convert(Boxes, _Page):
    """Gaussians in another file format: turned, cropped, or placed as a list says."""

    source: Path = option(
        PATH,
        "file of Gaussians (.ply, .compressed.ply, .spz, .sog, .glb, .usdc, .splat), or a JSON"
        " list of files and their places (docs/files.md)",
        required=True,
        flags=(),
        metavar="IN",
    )
    out: Path = option(
        PATH,
        "file to write; the end of its name says how: as above, or .usda, .usdz; .html: a web page"
        " to send, with the viewer inside; DIR/lod-meta.json: a run's levels of detail, for"
        " PlayCanvas",
        required=True,
        flags=(),
        metavar="OUT",
    )
    up: str | None = option(
        Choice(choices.AXES),
        "axis that points up in OUT (default: as readers of the format have it)",
    )
    from_up: str | None = option(
        Choice(choices.AXES),
        "axis that points up in IN (default: as the format has it; -y for .ply)",
    )
    sh_degree: int | None = option(
        integer(0, 3),
        "highest degree of view-dependent colour, 0 to 3 (default: as it is)",
        metavar="N",
    )
    plain: bool = option(
        FLAG,
        "for viewers without anti-aliasing: each Gaussian becomes as faint as it looks in the"
        " photos, on average; always done for .glb, .usd and .splat. Needs a run's result in its"
        " folder, or --scene",
        False,
    )


@dataclass(frozen=True, kw_only=True)
class Masks(Photos, Threads, Boxes, Device):
    """Masks of objects on many photos, from a few strokes on one."""

    scene: Path = option(PATH, MODEL, required=True, flags=())
    scribbles: Path = option(
        PATH,
        "JSON with strokes on the object and around it, in one photo or more (docs/files.md)",
        required=True,
        metavar="FILE",
    )
    model: Path | None = option(
        PATH,
        "PLY of the trained scene in the COLMAP frame; without it, masks are less exact",
        metavar="FILE",
    )
    photo: tuple[str, ...] = option(
        NAME,
        "a photo to make a mask for; repeatable (default: those that select chooses)",
        repeat=True,
        metavar="NAME",
    )
    anew: bool = option(
        FLAG, "recreate all masks: strokes that correct one photo then help the others", False
    )
    out: Path = option(
        PATH,
        "folder of the masks, of the box vase in DIR/vase; masks that are there and were not"
        " created by this command are used, and stay",
        required=True,
        metavar="DIR",
    )


@dataclass(frozen=True, kw_only=True)
class Cut(PhotoSize, Boxes, Device):
    """Objects cut out of their boxes, along masks on some photos."""

    scene: Path = option(PATH, MODEL, required=True, flags=())
    masks: Path | None = option(
        PATH,
        "folder with a folder of masks for each box: DIR/vase/012.jpg.png shows the object of box"
        " vase on the photo 012.jpg, all else is black (default: masks in the scene's folder)",
        metavar="DIR",
    )
    invert_masks: bool = option(FLAG, "black marks the object", False)
    model: Path = option(PATH, "PLY in the COLMAP frame", required=True, metavar="FILE")
    out: Path = option(
        PATH,
        f"folder to write to: {FINE}/ROI.ply, and {BACKGROUND} with all else",
        required=True,
        metavar="DIR",
    )


@dataclass(frozen=True, kw_only=True)
class Floaters(Scene, Boxes, Device):
    """Gaussians that hang in the air in a model."""

    model: Path = option(
        PATH,
        "PLY in the COLMAP frame, or a JSON list of PLYs and their places (docs/files.md)",
        required=True,
        metavar="FILE",
    )
    min_views: int = option(
        integer(1),
        "photos that must show what is before the boxes or the scene (default: {default})",
        choices.MIN_VIEWS,
        metavar="N",
    )
    out: Path = option(
        PATH,
        "NumPy file to write: for each Gaussian, in the order of the files, whether it is one",
        required=True,
        metavar="FILE.npy",
    )
