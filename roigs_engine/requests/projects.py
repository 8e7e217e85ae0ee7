"""Requests for COLMAP projects: reconstruct, inspect, refine, select photos."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from . import choices
from .declare import Request, argument, option
from .groups import MODEL, Boxes, Device, ObjectMasks, PhotoMasks, Scene, Selection, Threads
from .values import DIR, FILE, FLAG, PATH, Choice, Name, PathName, integer

MOST_FEATURES, LARGEST_SIDE, MOST_NEIGHBOURS, MOST_FRAMES = 32_768, 8_192, 1_000, 10_000
MOST_SUGGESTED = 100
FEW_PHOTOS, MANY, USUAL = 40, 8192, 2048  # up to 40 photos get MANY features each, more get USUAL


@dataclass(frozen=True, kw_only=True)
class ReconstructionMethod(Request, heading="method"):
    """Options that decide the result of a reconstruction."""

    max_side: int = option(
        integer(64, LARGEST_SIDE, metavar="PX"),
        "longest side of the photos while features are found (default: {default})",
        1600,
        label="Photo Size",
        tooltip="Longest side of the photos while features are found",
    )
    features: int = option(
        integer(64, MOST_FEATURES, zero=True),
        f"maximum number of features of a photo (default: 0, meaning {USUAL}, or {MANY} with up "
        f"to {FEW_PHOTOS} photos)",
        0,
    )
    pairs: str = option(
        Choice(choices.PAIRS),
        "photos to match: all pairs; similar photos; neighbours by name, and similar ones; or "
        "all pairs of few photos, otherwise similar photos (auto, the default)",
        "auto",
        label="Pairs",
        tooltip="Photos to match",
    )
    neighbours: int = option(
        integer(1, MOST_NEIGHBOURS),
        "number of similar photos to match with each (default: {default})",
        20,
    )
    cameras: str = option(
        Choice(choices.CAMERAS),
        "photos that share a camera: those with the same device, lens, focal length and size "
        "(auto, the default), all of one size, or none",
        "auto",
        label="Cameras",
        tooltip="Which photos share a camera",
    )
    camera_model: str = option(
        Choice(choices.CAMERA_MODELS), "COLMAP's lens model (default: {default})", "SIMPLE_RADIAL"
    )
    seed: int = option(integer(0), "seed of random numbers", 0)


@dataclass(frozen=True, kw_only=True)
class Reconstruct(PhotoMasks, ReconstructionMethod, Threads):
    """A COLMAP project from a folder of photos, or a video."""

    photos: Path = argument(PATH, "folder of the photos, or a video")
    out: Path = option(
        PathName("SCENE"),
        "folder of the project: gets images, sparse/0, database.db and reconstruction.md; the same"
        " command resumes",
        required=True,
    )
    frames: int | None = option(
        integer(2, MOST_FRAMES),
        "use about N frames of a video (default: by its motion)",
    )


@dataclass(frozen=True, kw_only=True)
class Inspect(Scene, Boxes):
    """Show the content of a COLMAP model, and the photos that see each box."""

    check_photos: bool = option(FLAG, "decode every photo, and skip damaged ones", False)
    json: bool = option(FLAG, "print the result as JSON", False)


@dataclass(frozen=True, kw_only=True)
class Export(Scene):
    """Cameras and points of a COLMAP model as JSON and NumPy files."""

    placed: bool = option(
        FLAG,
        "write in the scene's world, placed in Blender (roigs_placement.json), in metres; "
        "default: in the COLMAP frame",
        False,
    )
    out: Path = option(DIR, "folder to write to", required=True)


@dataclass(frozen=True, kw_only=True)
class ShowPhoto(Request):
    """A picture of a photo as training sees it."""

    photo_file: Path = argument(PATH, "file of the photo")
    lens: str | None = option(
        Name("CAMERA"),
        "undistort it from this camera, in the format of cameras.txt: 'MODEL WIDTH HEIGHT "
        "PARAMS' (default: no distortion)",
    )
    turn: int = option(integer(1, 8), "turn it by this EXIF orientation (default: {default})", 1)
    max_side: int = option(
        integer(1, LARGEST_SIDE, metavar="PX"), "longest side (default: {default})", 3000
    )
    out: Path = option(FILE, "JPEG to write", required=True)


@dataclass(frozen=True, kw_only=True)
class RefineCameras(Request):
    """Cameras that fit the photos better."""

    scene: Path = argument(PATH, MODEL)
    images: Path | None = option(DIR, "folder of the photos (default: the project's)")
    tracks_only: bool = option(
        FLAG,
        "use only the model's keypoints, not the photos: faster, less exact",
        False,
    )
    out: Path | None = option(DIR, "folder of the new model (default: sparse/refined)")


@dataclass(frozen=True, kw_only=True)
class Select(Scene, ObjectMasks, Boxes, Selection):
    """The photos that show each box best, in order."""

    out: Path | None = option(DIR, "write ROI.json files there")


@dataclass(frozen=True, kw_only=True)
class Suggest(Scene, ObjectMasks, Boxes, Device):
    """The next photos of each box, those that help most first."""

    count: int = option(
        integer(1, MOST_SUGGESTED),
        "photos to suggest for each box (default: {default})",
        8,
        label="Photos",
        tooltip="Number of photos to suggest for each box",
    )
    model: Path | None = option(
        FILE,
        "PLY of the trained scene in the COLMAP frame, to draw the preview of each photo "
        "(default: the sparse points)",
    )
    no_look: bool = option(FLAG, "do not read the photos: faster, and all count as sharp", False)
    out: Path = option(
        DIR,
        "folder to write to: suggestions.json (a camera path), suggestions.html and pictures",
        required=True,
    )


@dataclass(frozen=True, kw_only=True)
class Certify(Scene, ObjectMasks, Boxes):
    """A certificate of each boxed object: size, resolution, directions covered, scores."""

    run_dir: Path | None = option(
        DIR,
        "folder of a finished run of these boxes: its scores, software, settings and hashes are "
        "certified, too, its test photos do not count, and its reports get a section",
    )
    out: Path = option(
        DIR, "folder to write to: a page for each box, and certificates.json", required=True
    )
