"""Requests for trainings and their results: runs, evaluation, levels of detail, batches, upkeep."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from . import choices
from .declare import Request, argument, option
from .groups import (
    MAX_MEGABYTES,
    Boxes,
    Device,
    Exposures,
    Layout,
    ObjectMasks,
    Scene,
    Selection,
    Threads,
    Training,
)
from .values import DIR, FILE, FLAG, NAME, PATH, Choice, Name, Number, PathName, PlaceName, integer

MAX_SECONDS = 1e9
MOST_LEVELS, MOST_LEVEL_STEPS = 8, 100_000
MIN_FACES, MOST_FACES = 100, 10_000_000
MIN_TEXTURE, MOST_TEXTURE = 64, 16_384
MESH_FORMATS = ("obj", "ply", "stl", "usda", "usdc", "usdz")
MOST_JOBS, MOST_RETRIES, RETRIES = 1024, 100, 3
CLUSTER = (
    "on Ray: ray://HOST:10001, auto (this machine's cluster), or local (Ray on this machine only)"
)


@dataclass(frozen=True, kw_only=True)
class Train(Scene, Exposures, ObjectMasks, Boxes, Selection, Training, Layout, Device):
    """Scene and boxes trained, and one PLY written."""

    run_dir: Path = option(DIR, "folder of the run", required=True, decides=False)
    selection: Path | None = option(
        DIR,
        "folder of ROI.json files with the photos of each box, from `select --out`; --method "
        "selects the photos of boxes without a file",
    )
    levels: int | None = option(
        integer(2, MOST_LEVELS),
        "make N levels of detail of the result at the end, as `levels` does",
    )
    surface: bool = option(
        FLAG, "make a mesh of each box's contents at the end, as `surface` does", False
    )
    update: bool = option(
        FLAG,
        "reuse a run folder of other settings: valid stages are kept, the results move to its "
        "folder 'earlier'",
        False,
        decides=False,
    )
    dry_run: bool = option(
        FLAG,
        "print the plan (stages, photos, steps, memory, minutes) and train nothing",
        False,
        decides=False,
    )
    preview_seconds: float = option(
        Number(low=0, high=MAX_SECONDS, metavar="S"),
        "write the model in training to preview.ply, at most every S seconds; 0: never",
        0.0,
        decides=False,
    )
    image_cache: float | None = option(
        Number(low=0, high=MAX_MEGABYTES, metavar="MB"),
        "megabytes of decoded photos to keep in memory (default: a quarter of the memory)",
        decides=False,
    )
    cluster: str | None = option(Name("ADDRESS"), f"train {CLUSTER}", decides=False)


@dataclass(frozen=True, kw_only=True)
class TrainAndEvaluate(Train):
    """A training that is compared with baselines, and evaluated."""

    compare: tuple[str, ...] = option(
        Choice((*choices.COMPARISONS, "all")),
        "models to train for comparison, with the same number of steps (default: full-scene)",
        ("full-scene",),
        several=True,
        decides=False,
    )
    part: tuple[str, ...] = option(
        Name("PART"),
        "do only one part, as `batch` does, so that several engines can work in one run folder: "
        "'prepare', then the name of each stage, then 'all' for the rest; repeatable",
        repeat=True,
        decides=False,
    )


@dataclass(frozen=True, kw_only=True)
class Evaluate(Scene, Exposures, ObjectMasks, Boxes, Device):
    """The evaluation table of any PLYs, on test photos."""

    model: tuple[str, ...] = option(
        Name("NAME=FILE.ply"),
        "a row of the table; gains are relative to the first one; repeatable",
        required=True,
        repeat=True,
    )
    split: Path | None = option(
        FILE,
        "split.json of a run (default: that of the models' run)",
        excludes="tests",
    )
    test_every: int | None = option(
        integer(2),
        "test on every N-th photo that sees a box, even if a model was trained on it",
        excludes="tests",
    )
    out: Path = option(DIR, "folder to write to", required=True)


@dataclass(frozen=True, kw_only=True)
class Levels(Threads, Device):
    """Levels of detail of a run's result."""

    run: Path = argument(PATH, "folder of the run")
    levels: int = option(
        integer(2, MOST_LEVELS),
        "number of levels, including the full model; each has half the Gaussians of the "
        "previous one (default: {default})",
        5,
    )
    steps: int = option(
        integer(1, MOST_LEVEL_STEPS),
        "training steps for each level of each box (default: {default})",
        500,
    )
    scene: Path | None = option(DIR, "COLMAP project of the run, if it was moved")


@dataclass(frozen=True, kw_only=True)
class MakeSurface(Threads, Device):
    """The surfaces of a finished run's boxes, as meshes with the photos' texture."""

    run: Path = argument(PATH, "folder of the run")
    only: tuple[str, ...] = option(
        NAME, "only the box of this name; repeatable", repeat=True, flags=("--only", "--box")
    )
    background: bool = option(
        FLAG,
        "make one coarse mesh of the boxes' surroundings, for shadows and reflections; with "
        "--only, also the meshes of these boxes",
        False,
    )
    faces: int = option(
        integer(MIN_FACES, MOST_FACES),
        "maximum number of faces of a mesh (default: {default})",
        100_000,
        label="Faces",
        tooltip="Maximum number of faces of a mesh",
    )
    watertight: bool = option(
        FLAG,
        "close all holes, for 3D printing: unseen parts are filled",
        False,
        label="Watertight",
        tooltip="Close all holes, for 3D printing: unseen parts are filled",
    )
    texture_size: int | None = option(
        integer(MIN_TEXTURE, MOST_TEXTURE, metavar="PX"),
        "side of the texture (default: as fine as the photos)",
        label="Texture Size",
        tooltip="Side of the texture, in pixels",
    )
    format: tuple[str, ...] = option(
        Choice(MESH_FORMATS),
        "also write this format, beside the .glb; repeatable",
        repeat=True,
    )
    scene: Path | None = option(DIR, "COLMAP project of the run, if it was moved")


@dataclass(frozen=True, kw_only=True)
class Confidence(Threads, Device):
    """Measure how well the photos of a finished run cover each Gaussian."""

    run: Path = argument(PATH, "folder of the run")
    model: Path | None = option(
        FILE,
        "PLY in the COLMAP frame, or a JSON list of PLYs with matrices (default: the run's result)",
    )
    heat_map: bool = option(
        FLAG,
        "colour the Gaussians of a PLY by the number of directions: blue few, yellow many",
        False,
    )
    scene: Path | None = option(DIR, "COLMAP project of the run, if it was moved")
    out: Path = option(
        PathName("FILE.ply|FILE.npy"),
        "PLY of the model with three more properties, or a NumPy file with these columns for "
        "each Gaussian: number of photos that show it, number of their directions (of 128), "
        "error of its colours in the test photos (root mean square, 0 to 1; NaN: none shows it)",
        required=True,
    )


@dataclass(frozen=True, kw_only=True)
class Batch(Request):
    """The runs of a table of scenes, several at once, here or on a cluster."""

    table: Path | None = option(
        PathName("TABLE"), "TOML file with the scenes and their settings (docs/many.md)", flags=()
    )
    init: Path | None = option(PathName("FOLDER"), "write TABLE with the scenes of this folder")
    run_dir: Path | str | None = option(
        PlaceName("DIR"),
        "folder for the run folders of all scenes; also an address such as s3://BUCKET/RUNS",
    )
    scenes: tuple[str, ...] = option(
        NAME, "do only the scene of this name; repeatable", repeat=True, flags=("--scene",)
    )
    only: tuple[str, ...] = option(NAME, "no option of a batch", repeat=True, hidden="help")
    jobs: int | None = option(
        integer(1, MOST_JOBS),
        "maximum number of parts at a time on this machine (default: one for every two cores)",
    )
    cluster: str | None = option(Name("ADDRESS"), f"do the parts {CLUSTER}")
    retries: int = option(
        integer(0, MOST_RETRIES, zero=True),
        "number of retries of a part if its process is lost (default: {default})",
        RETRIES,
    )
    dry_run: bool = option(
        FLAG, "check the table and print its plan (stages, steps, memory, time); do no work", False
    )


@dataclass(frozen=True, kw_only=True)
class Clean(Request):
    """Remove recreatable files from a run folder."""

    run: Path = argument(PATH, "folder of the run; its results stay")
    dry_run: bool = option(FLAG, "print the files to remove, and remove nothing", False)


@dataclass(frozen=True, kw_only=True)
class CheckGpu(Device):
    """A GPU checked against the CPU, and timed."""

    brief: bool = option(FLAG, "only print the device for training, and why", False)
