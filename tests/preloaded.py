"""Imports for a process before engines are forked from it: all that a training needs.

An engine that imports them by itself takes longer for that than for a tiny scene.
"""

from __future__ import annotations

from contextlib import suppress
from importlib import import_module

from PIL import Image

from roigs_engine.commands.parser import build_parser
from roigs_engine.commands.table import COMMANDS

MODULES = (
    *("torch", "sklearn.gaussian_process"),
    *("roigs_engine.cli", "roigs_engine.run.folder", "roigs_engine.evaluation.crops"),
    *(f"roigs_engine.app.{name}" for name in ("convert", "evaluate", "objects", "render")),
    *(f"roigs_engine.app.{name}" for name in ("scenes", "train", "upkeep")),
    *(f"roigs_engine.colmap.{name}" for name in ("export", "inspect", "project")),
    *(f"roigs_engine.exchange.{name}" for name in ("compressed_ply", "formats", "gltf", "page")),
    *(f"roigs_engine.exchange.{name}" for name in ("sog", "splat", "spz", "transform")),
    "sklearn.cluster",
)
EXTRAS = ("flip_evaluator", "gsply", "imagecodecs", "pycolmap", "pygltflib")

for _name in MODULES:
    import_module(_name)
for _name in EXTRAS:
    with suppress(ImportError):
        import_module(_name)
for _name in COMMANDS:
    build_parser(_name)
Image.init()  # Pillow's readers of formats
