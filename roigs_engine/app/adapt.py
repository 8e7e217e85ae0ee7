"""Adapts a finished model to another renderer, by a short stage that draws like this renderer."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..context import QUIET, Context
from ..errors import ConfigError, EngineError, SceneError
from ..formats.events import StageStarted
from ..formats.scratch import new_scratch, remove_scratch
from ..formats.splat_ply import check_ply
from ..formats.targets import TARGETS, Target
from ..formats.text import counted
from ..requests.models import Adapt
from .evaluate import held_out
from .inputs import load_scene, on_device
from .instances import drawable_model
from .outputs import Result, refuse_inputs, refuse_run_files
from .run_scene import RunSource, source_of_run, used_photos, warn_of_other_model

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from ..model.gaussians import Gaussians
    from ..model.scene import PosedImage, SfmScene
    from ..training.config import TrainConfig
    from ..training.stage_data import StageData

STAGE = "adapt"
SAMPLE = 1000  # Gaussians of a model that are searched for in the photos


def adapt(request: Adapt, context: Context = QUIET) -> Result:
    """Train a finished model on its photos, drawn like the target, and write it.

    Raises:
        EngineError: an input cannot be used.
        Stopped: on request; nothing is left behind.
    """
    from ..photos.cache import PhotoCache

    refuse_run_files(request.out)
    if request.out.suffix.lower() != ".ply":
        raise ConfigError(f"--out {request.out} is not the name of a PLY.", "Write FILE.ply.")
    refuse_inputs([request.out], [request.model])
    check_ply(request.model)
    source = source_of_run(request.model)
    request = _with_source(request, source)
    assert request.scene is not None
    warn_of_other_model(request.model.parent, request.scene, request.images, context)
    target = TARGETS[request.made_for]
    model, frame = drawable_model(request.model, context.warn, context.check_cancelled)

    def check(cameras: SfmScene) -> None:
        _check_shown(model, frame.scene(cameras).images, request)

    with _undistorted() as cache:
        scene = load_scene(request, context, cache, check=check)
        scene = frame.scene(_training_photos(scene, request, source, context))
        context = on_device(context, request.device)
        import torch

        from ..training.photo_order import shuffled
        from ..training.stage_data import StageData

        context.info(f"Adapting {counted(len(model), 'Gaussian')} to {target.title}.")
        with PhotoCache(scene.images, context.photo_memory) as photos:
            data = StageData(
                images=scene.images,
                photos=photos,
                photo_at=shuffled(range(len(scene.images)), 0),
                extent=scene.extent(),
                device=torch.device(context.device),
            )
            made = adapted(model, data, target, request.steps, context)
    made.save_ply(request.out, frame)
    text = f"{counted(len(made), 'Gaussian')} made for {target.title} in {request.out}"
    return Result(files={"result": request.out}, text=text)


def adapted(
    model: Gaussians, data: StageData, target: Target, steps: int, context: Context = QUIET
) -> Gaussians:
    """Return the model on the CPU after steps on whole photos, rows in order; Stopped on request.

    For a target without anti-aliasing, it starts with opacities that are right on average.
    """
    from ..cuda.device import CPU
    from ..exchange.transform import without_antialiasing
    from ..training.edits import morton_order
    from ..training.trainer import Trainer

    if model.target.antialiased and not target.antialiased:
        model = without_antialiasing(model, data.images)
    context.emit(StageStarted(stage=STAGE, total=steps))
    trainer = Trainer(model, data, adaptation(model, target, steps), context)
    if not trainer.run(context, stage=STAGE):
        context.check_cancelled()
    in_order = morton_order(model.means).argsort()  # undoes the trainer's order of rows
    made = trainer.gaussians.to(CPU).rows(in_order)
    return replace(made, photo_focal=data.photo_focal)


def adaptation(model: Gaussians, target: Target, steps: int) -> TrainConfig:
    """Return the settings of the stage (notebook/blender.md): falling rates, no densification.

    Positions are already right and move slowly; everything else must change much in few steps.
    """
    from ..training.config import TrainConfig
    from ..training.mechanisms.falling_rates import FallingRates

    degree = round(model.sh.shape[1] ** 0.5) - 1
    return TrainConfig(
        steps=steps,
        sh_degree=degree,
        sh_start=degree,
        lr_means=8e-5,
        lr_means_final=8e-5,
        lr_sh0=3e-3,
        lr_shN=3e-3,
        lr_opacities=0.09,
        lr_scales=0.015,
        lr_quats=3e-3,
        made_for=target.name,
        mechanisms=(FallingRates(),),
    )


def _with_source(request: Adapt, source: RunSource) -> Adapt:
    """With the photos of the run that made the model, where none are given."""
    if request.scene is None and source.scene is None:
        raise ConfigError(
            f"The scene of {request.model} is unknown.", "Give its folder with --scene."
        )
    if request.scene is None:
        images = request.images or source.images
        request = replace(request, scene=source.scene, images=images)
    if not (request.masks or request.no_masks or request.invert_masks or request.no_exposures):
        request = replace(request, **source.options)
    sized = request.max_side is not None or request.downscale is not None
    return request if sized else replace(request, max_side=source.longest_side)


@contextmanager
def _undistorted() -> Iterator[Path]:
    """Create a folder for undistorted photos, removed at the end; EngineError if this fails."""
    try:
        folder, owner = new_scratch("roigs-adapt-")
    except OSError as error:
        raise EngineError(
            f"There is no folder for temporary files ({error.strerror}).",
            "Free some space, or set TMPDIR to another folder.",
        ) from error
    try:
        yield folder
    finally:
        remove_scratch(folder, owner)


def _training_photos(
    scene: SfmScene, request: Adapt, source: RunSource, context: Context
) -> SfmScene:
    """The scene without the photos that the model's run left out, or holds out to test on."""
    every, scene = len(scene.images), used_photos(scene, source.photos)
    names = {image.name for image in scene.images}
    if unused := every - len(names):
        context.info(f"Left out {counted(unused, 'photo')} that the run did not use.")
    tested = sorted(names & held_out(request.model))
    if not tested:
        return scene
    if len(tested) == len(names):
        raise ConfigError("All photos of the scene are test photos.", "Give the whole scene.")
    context.info(f"Left out {counted(len(tested), 'photo')} of the run's test set.")
    return scene.without(tested)


def _check_shown(model: Gaussians, images: Sequence[PosedImage], request: Adapt) -> None:
    """Raise SceneError if no photo shows any Gaussian of a sample of the model."""
    from ..rasterize.inputs import NEAR

    means = model.means[:: -(-len(model) // SAMPLE) or 1].double().numpy()
    for image in images:
        pose, camera = image.world_to_camera, image.camera
        points = means @ pose[:3, :3].T + pose[:3, 3]
        pixels = points[points[:, 2] > NEAR] @ camera.matrix().T
        pixels = pixels[:, :2] / pixels[:, 2:]
        if ((pixels > 0) & (pixels < (camera.width, camera.height))).all(axis=1).any():
            return
    raise SceneError(
        f"No photo of {request.scene} shows {request.model}.", "Give the model's own scene."
    )
