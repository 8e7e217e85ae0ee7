"""Options that several requests share, in groups."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..formats.run_files import OBJECT_MASKS
from . import choices
from .declare import Request, argument, option
from .values import DIR, FILE, FLAG, NAME, PATH, AutoOr, Choice, Name, NamedChoice, Number, integer

MAX_THREADS = 1024
MAX_MEGABYTES = 1e9
MODEL = "folder with a COLMAP model (sparse/0, sparse, or the model itself)"


@dataclass(frozen=True, kw_only=True)
class Threads(Request):
    """The threads of the CPU kernels."""

    threads: int | None = option(
        integer(1, MAX_THREADS), "CPU threads (default: the number of cores)", decides=False
    )


@dataclass(frozen=True, kw_only=True)
class Device(Request):
    """The device that renders and trains."""

    device: str = option(
        NamedChoice(choices.DEVICES),
        "auto uses an NVIDIA GPU, or another GPU faster than the CPU, if it passes its check; "
        "gpu:NAME is the GPU of that name (default: {default})",
        "auto",
        decides=False,
    )


@dataclass(frozen=True, kw_only=True)
class Photos(Request, heading="scene"):
    """The folder of the photos."""

    images: Path | None = option(
        DIR, "folder of the photos (default: images, images_2, images_4 or images_8)"
    )


@dataclass(frozen=True, kw_only=True)
class PhotoSize(Photos, Threads, heading="scene"):
    """The photos' folder and size."""

    downscale: float | None = option(
        Number(low=1, high=choices.MAX_DOWNSCALE), "divide the photos' size by N", excludes="size"
    )
    max_side: int | None = option(
        integer(1, choices.MAX_SIDE, metavar="PX"),
        "limit the photos' longest side to PX pixels",
        excludes="size",
        label="Photo Size",
        tooltip="Longest side of the photos in training; larger is sharper and slower",
    )


@dataclass(frozen=True, kw_only=True)
class PhotoMasks(Request, heading="scene"):
    """The ignored parts of the photos."""

    masks: Path | None = option(
        DIR,
        "folder of masks, 012.jpg.png for the photo 012.jpg; black pixels are ignored (default: "
        "the folder masks beside that of the photos, if there is one)",
        excludes="masks",
    )
    no_masks: bool = option(
        FLAG, "use whole photos: no masks, and no alpha channels", False, excludes="masks"
    )
    invert_masks: bool = option(FLAG, "in the masks' files, black marks the used pixels", False)


@dataclass(frozen=True, kw_only=True)
class Exposures(Request, heading="scene"):
    """Whether photos are levelled to one exposure."""

    no_exposures: bool = option(
        FLAG,
        "do not level the photos' exposures",
        False,
    )


@dataclass(frozen=True, kw_only=True)
class Scene(PhotoSize, PhotoMasks):
    """The scene, and how its photos are read."""

    scene: Path = argument(
        PATH, f"{MODEL}, or an options file (JSON) whose keys are the long names of these options"
    )
    exclude: tuple[str, ...] = option(
        Name("PHOTO"), "leave a photo out, by its name in the model; repeatable", repeat=True
    )


@dataclass(frozen=True, kw_only=True)
class ObjectMasks(Request, heading="masks of objects"):
    """Whether masks of the boxes' objects are used."""

    no_object_masks: bool = option(
        FLAG,
        "use whole boxes, without masks of their objects (the mask of box vase on the photo"
        " 012.jpg is masks/vase/012.jpg.png; white is the object)",
        False,
    )
    object_masks: Path | None = option(
        DIR,
        "folder with masks of objects, DIR/vase/012.jpg.png, for photos without one in the "
        f"folder masks (default for `train` and `run`: {OBJECT_MASKS} of the run folder, where "
        "Blender writes if it cannot write beside the photos)",
    )


@dataclass(frozen=True, kw_only=True)
class Boxes(Request, heading="boxes"):
    """The boxes."""

    rois: Path | None = option(FILE, "rois.json with the boxes")
    roi: tuple[str, ...] = option(
        Name("NAME=x0,y0,z0,x1,y1,z1"),
        "one box by its corners in the COLMAP frame; repeatable. auto (select, suggest, train, "
        "run): a box around the main object of the photos, written to rois.json",
        repeat=True,
    )
    only: tuple[str, ...] = option(
        NAME, "use only the box of this name; repeatable", repeat=True, flags=("--only", "--box")
    )


@dataclass(frozen=True, kw_only=True)
class Selection(Request, heading="selection"):
    """The selection of photos, and the test photos."""

    method: str | None = option(
        Choice(choices.METHODS),
        "how to select photos",
        label="Method",
        tooltip="How to select the photos of each box",
    )
    count: int | None = option(
        integer(1, metavar="K"),
        "number of photos to select for each box",
        label="Photos",
        tooltip="Number of photos for each box; 0: the method decides",
    )
    seed: int | None = option(
        integer(0, choices.MAX_SEED),
        "seed of all random numbers (default: 0)",
        label="Seed",
        tooltip="Seed of all random choices",
    )
    test_every: int | None = option(
        integer(2, zero=True),
        "make every N-th photo that sees a box a test photo; 0: none",
        label="Test Photos",
        tooltip="Hold out test photos to measure quality: 8 means one photo in eight; 0: none",
    )


@dataclass(frozen=True, kw_only=True)
class Training(Request, heading="training"):
    """The preset, and settings that override it."""

    preset: str = option(
        Choice(choices.PRESETS),
        "settings (default: {default})",
        "draft",
        label="Preset",
        tooltip="Steps and settings of a training",
    )
    strategy: str | None = option(
        Choice(choices.STRATEGIES),
        "one joint stage for all boxes, or one for each box",
        label="Boxes",
        tooltip="Train boxes together or one by one",
    )
    steps_factor: float | None = option(
        Number(low=0, high=choices.MAX_FACTOR, above=True, metavar="F"),
        "multiply the steps of both stages by F",
        label="Steps ×",
        tooltip="Multiplies the preset's steps: fewer are faster, more are finer",
    )
    kept_share: float | None = option(
        Number(low=0, high=1),
        "share of the selected photos, 0 to 1, that the Scene-GS also uses",
        hidden="line",
    )
    roi_init: str | None = option(
        Choice(choices.INITS),
        "start of the box stage: the Scene-GS, the sparse points, or the Scene-GS's Gaussians "
        "in the box",
        hidden="line",
    )
    roi_order: str | None = option(
        Choice(choices.ORDERS), "order of the selected photos", hidden="line"
    )
    sh_degree: int | None = option(integer(0, 3), "highest SH degree, 0 to 3")
    made_for: str | None = option(
        Choice(choices.MADE_FOR),
        "the renderer to make the result for: viewers with anti-aliasing, plain ones without "
        "(also glTF, USD, .splat), or Blender 5.3's own splats in Cycles or EEVEE (default: "
        "viewers; plain in `paper`)",
        label="Made for",
        tooltip="The renderer you want to use the result in",
    )
    evaluate_on: str | None = option(
        Choice(choices.PHOTOS),
        "photos to evaluate on: the test photos (default), or validation photos, for choosing "
        "settings; then nothing uses the test photos",
    )


@dataclass(frozen=True, kw_only=True)
class Layout(Request, heading="large scenes, many boxes"):
    """The layout of training: blocks of the scene, groups of boxes."""

    blocks: int | str | None = option(
        AutoOr(low=1, high=choices.MOST_BLOCKS),
        "divide the scene into N blocks, train them one by one and join them; auto: as many as "
        "this machine's memory needs (default: 1)",
    )
    group: tuple[str, ...] = option(
        Name("BOX,BOX"),
        "boxes to train together, separately from the others; repeatable; all: all boxes "
        "(default: boxes that share photos)",
        repeat=True,
    )
