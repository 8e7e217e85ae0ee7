"""ROI-GS: sharper objects in boxes, in 3D Gaussian Splatting scenes.

Each piece of work is a function of a request. A request is a frozen dataclass; its fields are the
options of a command (`help(roigs_engine.Train)`):

    from pathlib import Path
    from roigs_engine import Train, train

    request = Train(scene=Path("garden"), roi=("auto",), run_dir=Path("runs/garden"))
    print(train(request).result)

Nothing is printed; a `Context` with `emit` receives the events. The parts of these functions are
public too: scenes, boxes, selection, plans, training and rendering. Names are imported on first
use. So `import roigs_engine` and everything before training work without torch.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False  # not from `typing`: a Ctrl-C during that import would be a traceback

__version__ = "0.1.0"

if TYPE_CHECKING:
    from typing import Any

    from .app.adapt import adapt as adapt
    from .app.batch import run_batch as run_batch
    from .app.certify import certify as certify
    from .app.cluster import train_on_cluster as train_on_cluster
    from .app.confidence import find_confidence as find_confidence
    from .app.convert import convert as convert
    from .app.evaluate import evaluate as evaluate
    from .app.masks import make_masks as make_masks
    from .app.objects import compose as compose
    from .app.objects import cut as cut
    from .app.objects import find_floaters as find_floaters
    from .app.render import render as render
    from .app.render import render_frames as render_frames
    from .app.scenes import export as export
    from .app.scenes import inspect as inspect
    from .app.scenes import reconstruct as reconstruct
    from .app.scenes import refine_cameras as refine_cameras
    from .app.scenes import select as select
    from .app.scenes import show_photo as show_photo
    from .app.suggest import suggest as suggest
    from .app.surface import make_surfaces as make_surfaces
    from .app.train import plan_training as plan_training
    from .app.train import train as train
    from .app.train import train_parts as train_parts
    from .app.upkeep import check_gpu as check_gpu
    from .app.upkeep import clean as clean
    from .app.upkeep import make_levels as make_levels
    from .colmap.project import load_colmap as load_colmap
    from .context import Context as Context
    from .errors import EngineError as EngineError
    from .model.gaussians import Gaussians as Gaussians
    from .model.roi import OrientedBox as OrientedBox
    from .model.roi import load_rois as load_rois
    from .model.scene import Camera as Camera
    from .model.scene import PosedImage as PosedImage
    from .model.scene import SfmScene as SfmScene
    from .model.visibility import visible_images as visible_images
    from .rasterize import RenderOutput as RenderOutput
    from .rasterize.camera_path import load_camera_path as load_camera_path
    from .rasterize.view import render_view as render_view
    from .requests.models import Adapt as Adapt
    from .requests.models import Compose as Compose
    from .requests.models import Convert as Convert
    from .requests.models import Cut as Cut
    from .requests.models import Floaters as Floaters
    from .requests.models import Masks as Masks
    from .requests.models import Panorama as Panorama
    from .requests.models import Render as Render
    from .requests.models import RenderFrames as RenderFrames
    from .requests.projects import Certify as Certify
    from .requests.projects import Export as Export
    from .requests.projects import Inspect as Inspect
    from .requests.projects import Reconstruct as Reconstruct
    from .requests.projects import RefineCameras as RefineCameras
    from .requests.projects import Select as Select
    from .requests.projects import ShowPhoto as ShowPhoto
    from .requests.projects import Suggest as Suggest
    from .requests.runs import Batch as Batch
    from .requests.runs import CheckGpu as CheckGpu
    from .requests.runs import Clean as Clean
    from .requests.runs import Confidence as Confidence
    from .requests.runs import Evaluate as Evaluate
    from .requests.runs import Levels as Levels
    from .requests.runs import MakeSurface as MakeSurface
    from .requests.runs import Train as Train
    from .requests.runs import TrainAndEvaluate as TrainAndEvaluate
    from .run.config import RunConfig as RunConfig
    from .run.definition import Run as Run
    from .run.definition import define_run as define_run
    from .run.presets import preset as preset
    from .run.strategies import plan_run as plan_run
    from .selection import CameraSelection as CameraSelection
    from .selection import SelectionConfig as SelectionConfig
    from .selection import select_cameras as select_cameras
    from .selection.split import choose_test_views as choose_test_views
    from .training.checkpoint import load_checkpoint as load_checkpoint
    from .training.checkpoint import save_checkpoint as save_checkpoint
    from .training.config import TrainConfig as TrainConfig
    from .training.stage_data import StageData as StageData
    from .training.trainer import Trainer as Trainer

_MODULES = {
    "app.adapt": "adapt",
    "app.batch": "run_batch",
    "app.certify": "certify",
    "app.cluster": "train_on_cluster",
    "app.confidence": "find_confidence",
    "app.convert": "convert",
    "app.evaluate": "evaluate",
    "app.masks": "make_masks",
    "app.objects": "compose cut find_floaters",
    "app.panorama": "draw_panorama",
    "app.render": "render render_frames",
    "app.scenes": "export inspect reconstruct refine_cameras select show_photo",
    "app.suggest": "suggest",
    "app.surface": "make_surfaces",
    "app.train": "plan_training train train_parts",
    "app.upkeep": "check_gpu clean make_levels",
    "requests.models": "Adapt Compose Convert Cut Floaters Masks Panorama Render RenderFrames",
    "requests.projects": "Certify Export Inspect Reconstruct RefineCameras Select ShowPhoto"
    " Suggest",
    "requests.runs": "Batch CheckGpu Clean Confidence Evaluate Levels MakeSurface Train"
    " TrainAndEvaluate",
    "colmap.project": "load_colmap",
    "context": "Context",
    "errors": "EngineError",
    "model.gaussians": "Gaussians",
    "model.roi": "OrientedBox load_rois",
    "model.scene": "Camera PosedImage SfmScene",
    "model.visibility": "visible_images",
    "rasterize": "RenderOutput",
    "rasterize.camera_path": "load_camera_path",
    "rasterize.view": "render_view",
    "run.config": "RunConfig",
    "run.definition": "Run define_run",
    "run.presets": "preset",
    "run.strategies": "plan_run",
    "selection": "CameraSelection SelectionConfig select_cameras",
    "selection.split": "choose_test_views",
    "training.checkpoint": "load_checkpoint save_checkpoint",
    "training.config": "TrainConfig",
    "training.trainer": "StageData Trainer",
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names.split()}

__all__ = list(_MODULE_OF)


def __getattr__(name: str) -> Any:
    """A public name, imported from its module now."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f".{_MODULE_OF[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
