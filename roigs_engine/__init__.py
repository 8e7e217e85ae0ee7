"""ROI-GS: boxed objects trained sharper inside 3D Gaussian Splatting scenes.

The public names below are imported on first use. So `import roigs_engine`, the camera selection and
everything else before training work without torch:

    from roigs_engine import load_colmap, load_rois, select_cameras, SelectionConfig

    scene = load_colmap("garden", max_side=640)
    (vase,) = load_rois("garden/rois.json")
    print(select_cameras(scene, vase, SelectionConfig()).names)

A package cannot hold a module and a function of the same name, so import these functions from their
modules: `roigs_engine.rasterize.rasterize`, `roigs_engine.evaluation.evaluate.evaluate`.
"""

from __future__ import annotations

import importlib

TYPE_CHECKING = False  # not from `typing`: a Ctrl-C during that import would be a traceback

__version__ = "0.1.0"

if TYPE_CHECKING:
    from typing import Any

    from .colmap.project import load_colmap
    from .errors import EngineError
    from .model.gaussians import Gaussians
    from .model.roi import OrientedBox, load_rois
    from .model.scene import Camera, PosedImage, SfmScene
    from .model.visibility import visible_images
    from .rasterize import RenderOutput
    from .rasterize.camera_path import load_camera_path
    from .rasterize.view import render_view
    from .run.config import RunConfig
    from .run.definition import Run, define_run
    from .run.folder import train_run
    from .run.presets import preset
    from .run.strategies import plan_run
    from .selection import CameraSelection, SelectionConfig, select_cameras
    from .selection.split import choose_test_views
    from .training.checkpoint import load_checkpoint, save_checkpoint
    from .training.config import TrainConfig
    from .training.stage_data import StageData
    from .training.trainer import Trainer

_MODULES = {
    "colmap.project": ("load_colmap",),
    "errors": ("EngineError",),
    "model.gaussians": ("Gaussians",),
    "model.roi": (
        "OrientedBox",
        "load_rois",
    ),
    "model.scene": (
        "Camera",
        "PosedImage",
        "SfmScene",
    ),
    "model.visibility": ("visible_images",),
    "rasterize": ("RenderOutput",),
    "rasterize.camera_path": ("load_camera_path",),
    "rasterize.view": ("render_view",),
    "run.config": ("RunConfig",),
    "run.definition": ("Run", "define_run"),
    "run.folder": ("train_run",),
    "run.strategies": ("plan_run",),
    "run.presets": ("preset",),
    "selection": (
        "CameraSelection",
        "SelectionConfig",
        "select_cameras",
    ),
    "selection.split": ("choose_test_views",),
    "training.checkpoint": (
        "load_checkpoint",
        "save_checkpoint",
    ),
    "training.config": ("TrainConfig",),
    "training.trainer": (
        "StageData",
        "Trainer",
    ),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [  # noqa: RUF022 - grouped by topic
    "Camera",
    "PosedImage",
    "SfmScene",
    "load_colmap",
    "OrientedBox",
    "load_rois",
    "CameraSelection",
    "SelectionConfig",
    "select_cameras",
    "visible_images",
    "choose_test_views",
    "Gaussians",
    "RenderOutput",
    "load_camera_path",
    "render_view",
    "RunConfig",
    "TrainConfig",
    "preset",
    "StageData",
    "Trainer",
    "load_checkpoint",
    "save_checkpoint",
    "Run",
    "define_run",
    "plan_run",
    "train_run",
    "EngineError",
]


def __getattr__(name: str) -> Any:
    """A public name, imported from its module now."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f".{_MODULE_OF[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
