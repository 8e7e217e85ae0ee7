"""Requests for trained models: pictures, file formats, objects, masks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..formats.run_files import BACKGROUND, FINE
from . import choices
from .declare import Request, argument, option
from .groups import MODEL, Boxes, Device, Exposures, PhotoMasks, Photos, PhotoSize, Scene, Threads
from .values import (
    DIR,
    FAR,
    FILE,
    FLAG,
    NAME,
    PATH,
    Choice,
    Name,
    Number,
    PathName,
    Place,
    integer,
)

MIN_PANORAMA, MOST_PANORAMA = 64, 8192
MOST_HIGHLIGHTS = 1000


@dataclass(frozen=True, kw_only=True)
class Render(PhotoSize, Device):
    """Pictures of a PLY from the cameras of a COLMAP model, or along a camera path."""

    ply: Path = argument(PATH, "PLY to render")
    scene: Path | None = option(DIR, "COLMAP project with the cameras", excludes="cameras!")
    path: Path | None = option(
        FILE,
        "camera path, a JSON file (docs/files.md); --downscale and --max-side apply to it",
        excludes="cameras!",
    )
    name: tuple[str, ...] = option(
        NAME, "render only the camera of this name; repeatable", repeat=True
    )
    levels: bool = option(
        FLAG, "draw the result of a run with its levels of detail (levels.json)", False
    )
    quality: float = option(
        Number(low=0.01, high=100, metavar="Q"),
        "with --levels: draw levels Q times finer (default: {default})",
        1.0,
    )
    out: Path = option(DIR, "folder for the pictures", required=True)


@dataclass(frozen=True, kw_only=True)
class RenderFrames(Threads, Device):
    """Pictures for compositing, as another program asks for them."""

    folder: Path = argument(PATH, "folder of the requests, JSON files (docs/files.md)")
    once: bool = option(FLAG, "end after the last request", False)


@dataclass(frozen=True, kw_only=True)
class Panorama(Threads, Device):
    """The light from all around a point, for the world of another program."""

    model: Path = argument(
        PATH,
        "PLY, in the frame of its COLMAP project, or a JSON list of PLYs with matrices "
        "(docs/files.md), z up",
    )
    at: tuple[tuple[float, float, float], ...] = option(
        Place("X,Y,Z"),
        "point that receives the light, in the frame of MODEL; write --at=-1,0,2 if it begins "
        "with a minus; repeatable, with the files FILE-1, FILE-2 ...",
        required=True,
        repeat=True,
    )
    out: Path = option(PathName("FILE.hdr"), "picture to write, Radiance HDR", required=True)
    width: int = option(
        integer(MIN_PANORAMA, MOST_PANORAMA, metavar="PX"),
        "width of the picture; it is half as high (default: {default})",
        1024,
    )
    without: tuple[str, ...] = option(
        NAME, "leave out the contents of this box; repeatable", repeat=True
    )
    near: float = option(
        Number(low=0, high=FAR, metavar="R"),
        "leave out Gaussians with centres nearer than R to the point (default: {default})",
        0.0,
    )
    highlights: float | None = option(
        Number(low=1, high=MOST_HIGHLIGHTS, metavar="K"),
        "brightness of lamps and windows relative to the photos' white (default: estimated from "
        "the shading)",
        label="Highlights",
        tooltip="Brightness of lamps and windows relative to the photos' white",
    )
    unseen: float | None = option(
        Number(low=1, high=MOST_HIGHLIGHTS, metavar="K"),
        "brightness of unseen parts above the horizon (lamps, the sky) relative to their "
        "surroundings (default: estimated from the shading)",
        label="Unseen Light",
        tooltip="Brightness of unseen parts above the horizon relative to their surroundings",
    )
    run: Path | None = option(
        DIR,
        "run folder of MODEL, with its boxes, and the background mesh of `surface --background` "
        "for the estimate (default: the folder of MODEL)",
    )


@dataclass(frozen=True, kw_only=True)
class Compose(Boxes):
    """A scene's Gaussians in boxes replaced by those of object models."""

    scene_ply: Path = argument(PATH, "PLY of the whole scene")
    object: tuple[str, ...] = option(
        Name("ROI=FILE.ply"),
        "PLY with Gaussians to replace the scene's in the box; repeatable",
        required=True,
        repeat=True,
    )
    out: Path = option(FILE, "PLY to write", required=True)


@dataclass(frozen=True, kw_only=True)
class Adapt(PhotoSize, PhotoMasks, Exposures, Device):
    """A finished model, made for another renderer by a short training on its photos."""

    model: Path = argument(
        PATH, "PLY to adapt, of a run or of another program, in the frame of the COLMAP project"
    )
    scene: Path | None = option(
        DIR,
        "COLMAP project it was trained on (default: that of MODEL's run folder, with its photos' "
        "size, masks and exposures)",
    )
    made_for: str = option(
        Choice(choices.MADE_FOR), "the renderer to adapt it to, as of `train`", required=True
    )
    steps: int = option(integer(1, choices.MOST_STEPS), "training steps (default: {default})", 300)
    out: Path = option(FILE, "PLY to write", required=True)


@dataclass(frozen=True, kw_only=True)
class _Page(Request, heading="web page (OUT.html)"):
    """Options of a page besides the model."""

    title: str | None = option(Name("TEXT"), "title of the page (default: the name of OUT)")
    fly_to: Path | None = option(FILE, "rois.json: a button to fly to each box; crops nothing")
    before: Path | None = option(FILE, "a second model, to switch between before/after")
    mesh: tuple[Path, ...] = option(
        FILE, "a mesh made by surface (.glb), to switch to; repeatable", repeat=True
    )
    page_scene: Path | None = option(
        DIR,
        "COLMAP project IN was trained on: its photos determine the up direction and the first "
        "view (default: that of IN's run folder, if it has one); also for --plain",
        flags=("--scene",),
    )


@dataclass(frozen=True, kw_only=True)
class Convert(Boxes, _Page):
    """Gaussians in another file format: turned, cropped, or placed as a list says."""

    source: Path = argument(
        PathName("IN"),
        "file of Gaussians (.ply, .compressed.ply, .spz, .sog, meta.json, .glb, .gltf, .usd, "
        ".usdc, .splat), a JSON list of files with matrices (docs/files.md), or a mesh (.glb)",
    )
    out: Path = argument(
        PathName("OUT"),
        "file to write; its suffix selects the format: .ply, .compressed.ply, .spz, .sog, .glb, "
        ".usdc, .usda, .usdz, .splat; .html: a web page to send, with the viewer inside; "
        "DIR/lod-meta.json: a run's levels of detail, for PlayCanvas. Of a mesh: .obj, .ply, "
        ".stl, .usdc, .usda, .usdz",
    )
    up: str | None = option(
        Choice(choices.AXES),
        "up axis of OUT (default: the format's convention)",
    )
    from_up: str | None = option(
        Choice(choices.AXES),
        "up axis of IN (default: the file's, otherwise the format's convention; -y for .ply)",
    )
    sh_degree: int | None = option(
        integer(0, 3), "highest degree of view-dependent colour, 0 to 3 (default: unchanged)"
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

    scene: Path = argument(PATH, MODEL)
    scribbles: Path = option(
        FILE,
        "JSON with strokes on the object and around it, in one photo or more (docs/files.md)",
        required=True,
    )
    model: Path | None = option(
        FILE, "PLY of the trained scene in the COLMAP frame; without it, masks are less exact"
    )
    photo: tuple[str, ...] = option(
        NAME,
        "a photo to make a mask for; repeatable (default: the photos of `select`)",
        repeat=True,
    )
    anew: bool = option(
        FLAG, "recreate all masks, so that corrections on one photo help the others", False
    )
    out: Path = option(
        DIR,
        "folder of the masks; those of box vase are in DIR/vase; your own masks there are used "
        "and kept",
        required=True,
    )


@dataclass(frozen=True, kw_only=True)
class Cut(PhotoSize, Boxes, Device):
    """Objects cut out of their boxes, along masks on some photos."""

    scene: Path = argument(PATH, MODEL)
    masks: Path | None = option(
        DIR,
        "folder with a folder of masks for each box: DIR/vase/012.jpg.png shows the object of "
        "box vase on the photo 012.jpg, the rest is black (default: masks in the scene's folder)",
    )
    invert_masks: bool = option(FLAG, "black marks the object", False)
    model: Path = option(FILE, "PLY in the COLMAP frame", required=True)
    out: Path = option(
        DIR, f"folder to write to: {FINE}/ROI.ply, and {BACKGROUND} with the rest", required=True
    )


@dataclass(frozen=True, kw_only=True)
class Floaters(Scene, Boxes, Device):
    """Find Gaussians in the air of a model."""

    model: Path = option(
        FILE,
        "PLY in the COLMAP frame, or a JSON list of PLYs with matrices (docs/files.md)",
        required=True,
    )
    min_views: int = option(
        integer(1),
        "minimum number of photos that must show a Gaussian in front of the boxes or the scene "
        "(default: {default})",
        choices.MIN_VIEWS,
    )
    out: Path = option(
        PathName("FILE.npy"),
        "NumPy file to write: true for each floater, in the order of the files",
        required=True,
    )
