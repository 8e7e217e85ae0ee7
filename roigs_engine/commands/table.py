"""Table of the commands: request, function, help, examples, and printed result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ..requests import models, projects, runs
from ..requests.declare import Request, options_of

if TYPE_CHECKING:
    from ..app.outputs import Result
    from ..context import Context

ALL = "all"  # the part of a run that includes everything still missing
Say = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command of the command line."""

    request: type[Request]
    does: str | Callable[[Any], str]  # `MODULE:FUNCTION` of `app`, or a function of the request
    help: str  # one line
    examples: tuple[str, ...]  # for the help; the words after the command
    torch: bool = True  # whether it needs torch, which needs much memory to start
    as_it_goes: bool = False  # whether its function gets `say`, to print lines before the result

    @property
    def takes_file(self) -> bool:
        """Whether its scene may be an options file."""
        scene = options_of(self.request).get("scene")
        return scene is not None and scene.required

    def run(self, request: Request, context: Context, say: Say) -> Result:
        """Run the command's function; returns the result."""
        does = self.does if isinstance(self.does, str) else self.does(request)
        module, _, name = does.partition(":")
        work: Callable[..., Result] = getattr(import_module(f"..app.{module}", __package__), name)
        context.check_cancelled()  # importing takes seconds
        return work(request, context, *([say] if self.as_it_goes else []))


def _training(request: runs.Train) -> str:
    """The function for a training: plan it, send it to a cluster, train parts or all of it."""
    if request.dry_run:
        return "train:plan_training"
    if request.cluster:
        return "cluster:train_on_cluster"
    parts = request.part if isinstance(request, runs.TrainAndEvaluate) else ()
    return "train:train_parts" if parts and ALL not in parts else "train:train"


COMMANDS: dict[str, Command] = {
    "reconstruct": Command(
        request=projects.Reconstruct,
        does="scenes:reconstruct",
        help="make a COLMAP project from a folder of photos, or a video",
        examples=(
            "photos --out garden",
            "garden/images --out garden --pairs all",
            "walk.mp4 --out garden",
        ),
        torch=False,
    ),
    "inspect": Command(
        request=projects.Inspect,
        does="scenes:inspect",
        help="show the content of a COLMAP model and the photos that see each box",
        examples=("garden", "garden --rois garden/rois.json --json"),
        torch=False,
    ),
    "export": Command(
        request=projects.Export,
        does="scenes:export",
        help="write the cameras and points of a COLMAP model as JSON and NumPy files",
        examples=(
            "garden --out out",
            "garden --max-side 640 --out out --events",
            "garden --placed --out metres",
        ),
        torch=False,
    ),
    "show-photo": Command(
        request=projects.ShowPhoto,
        does="scenes:show_photo",
        help="write a picture of a photo as training sees it: upright, undistorted, in sRGB",
        examples=(
            "garden/images/a.jpg --out a.jpg",
            "a.jpg --lens 'SIMPLE_RADIAL 4000 3000 2900 2000 1500 -0.08' --out flat.jpg",
        ),
        torch=False,
    ),
    "refine-cameras": Command(
        request=projects.RefineCameras,
        does="scenes:refine_cameras",
        help="improve the fit of a COLMAP model's cameras, for sharper results",
        examples=("garden", "garden --out garden-refined"),
        torch=False,
    ),
    "select": Command(
        request=projects.Select,
        does="scenes:select",
        help="select the best photos of each box",
        examples=(
            "garden --rois garden/rois.json",
            'garden --roi "vase=0,0,0,1,1,2" --method gp9 --count 40 --out out',
        ),
        torch=False,
    ),
    "suggest": Command(
        request=projects.Suggest,
        does="suggest:suggest",
        help="suggest the next photos to take: the most informative for each box",
        examples=(
            "garden --rois garden/rois.json --out next",
            "garden --rois garden/rois.json --count 4 --model runs/garden/result.ply --out next",
        ),
        torch=False,
    ),
    "certify": Command(
        request=projects.Certify,
        does="certify:certify",
        help="write a certificate of each boxed object: its size, its coverage by photos, its "
        "model's scores",
        examples=("garden --rois garden/rois.json --run-dir runs/garden --out certificates",),
        torch=False,
    ),
    "train": Command(
        request=runs.Train,
        does=_training,
        help="select photos, train the scene and its boxes, and write one PLY",
        examples=(
            "garden --rois garden/rois.json --run-dir runs/garden",
            "garden --rois garden/rois.json --run-dir runs/garden --dry-run",
            "garden --rois garden/rois.json --run-dir runs/paper --preset paper",
        ),
    ),
    "run": Command(
        request=runs.TrainAndEvaluate,
        does=_training,
        help="train, then compare with baselines and evaluate",
        examples=(
            "garden --rois garden/rois.json --max-side 640 --run-dir runs/garden",
            "garden --rois garden/rois.json --run-dir runs/garden --dry-run",
            "garden --rois garden/rois.json --run-dir runs/all --compare all",
        ),
    ),
    "batch": Command(
        request=runs.Batch,
        does="batch:run_batch",
        help="train a table of scenes, several at once, here or on a cluster",
        examples=(
            "museum.toml --init scans",
            "museum.toml --run-dir runs/museum --dry-run",
            "museum.toml --run-dir runs/museum --jobs 4",
            "museum.toml --run-dir runs/museum --cluster auto",
        ),
    ),
    "evaluate": Command(
        request=runs.Evaluate,
        does="evaluate:evaluate",
        help="compare PLYs on test photos, in each box and on the whole image",
        examples=(
            "garden --rois garden/rois.json --split runs/garden/split.json --out out --model"
            ' "Full Scene=runs/garden/stages/full-scene-1f0c9a3e/model.ply" --model'
            " Ours=runs/garden/result.ply",
        ),
    ),
    "render": Command(
        request=models.Render,
        does="render:render",
        help="render a PLY from the cameras of a COLMAP model or along a camera path",
        examples=(
            "result.ply --scene garden --name IMG_0004.jpg --out frames",
            "result.ply --path cameras.json --out frames",
        ),
    ),
    "render-frames": Command(
        request=models.RenderFrames,
        does="render:render_frames",
        help="render pictures for compositing, on request by another program",
        examples=("requests --once",),
    ),
    "panorama": Command(
        request=models.Panorama,
        does="panorama:draw_panorama",
        help="draw the light around a point as a panorama, for the world of another program",
        examples=(
            "runs/garden/result.ply --at=-0.4,0.1,0.9 --out light.hdr",
            "runs/garden/result.ply --at 0,0,1 --without vase --highlights 8 --out light.hdr",
        ),
    ),
    "compose": Command(
        request=models.Compose,
        does="objects:compose",
        help="replace a scene's Gaussians in the boxes by those of object models",
        examples=("scene.ply --rois rois.json --object vase=vase.ply --out all.ply",),
    ),
    "adapt": Command(
        request=models.Adapt,
        does="adapt:adapt",
        help="adapt a finished model to another renderer, by a short training on its photos",
        examples=(
            "runs/garden/result.ply --made-for cycles --out garden-cycles.ply",
            "other.ply --scene garden --max-side 1600 --made-for plain --out plain.ply",
        ),
    ),
    "convert": Command(
        request=models.Convert,
        does="convert:convert",
        help="write Gaussians in another format, also rotated, cropped to boxes, or merged from "
        "a list",
        examples=(
            "runs/garden/result.ply garden.spz",
            "result.ply vase.glb --rois rois.json --only vase --sh-degree 0",
            "placed.json garden.compressed.ply",
            "result.ply vase.html --fly-to rois.json --before old.ply",
        ),
    ),
    "masks": Command(
        request=models.Masks,
        does="masks:make_masks",
        help="make masks of an object on many photos from a few strokes on one",
        examples=(
            "garden --rois garden/rois.json --scribbles strokes.json "
            "--model runs/garden/result.ply --out garden/masks",
        ),
    ),
    "cut": Command(
        request=models.Cut,
        does="objects:cut",
        help="cut objects out of their boxes along masks: the vase without the table under it",
        examples=("garden --rois garden/rois.json --model runs/garden/result.ply --out cut",),
    ),
    "floaters": Command(
        request=models.Floaters,
        does="objects:find_floaters",
        help="find floaters, by the same rule as in training",
        examples=("garden --rois garden/rois.json --model result.ply --out floaters.npy",),
    ),
    "levels": Command(
        request=runs.Levels,
        does="upkeep:make_levels",
        help="make levels of detail of a run's result: fewer Gaussians for distant views",
        examples=("runs/garden",),
    ),
    "surface": Command(
        request=runs.MakeSurface,
        does="surface:make_surfaces",
        help="make meshes of a run's objects, with texture from the photos",
        examples=("runs/garden", "runs/garden --only vase --watertight --format stl"),
    ),
    "confidence": Command(
        request=runs.Confidence,
        does="confidence:find_confidence",
        help="measure how well the photos cover each Gaussian: photos, directions, error",
        examples=(
            "runs/garden --out known.ply",
            "runs/garden --heat-map --out heat.ply",
        ),
    ),
    "clean": Command(
        request=runs.Clean,
        does="upkeep:clean",
        help="remove recreatable files: caches, stages of earlier settings, previews",
        examples=("runs/garden --dry-run", "runs/garden"),
        torch=False,
    ),
    "check-gpu": Command(
        request=runs.CheckGpu,
        does="upkeep:check_gpu",
        help="check a GPU against the CPU, and time training steps on both",
        examples=("", "--brief", "--device gpu"),
        as_it_goes=True,
    ),
}
