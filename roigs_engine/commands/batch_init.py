"""`batch --init`: the table of the scenes that a folder has."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path

from ..errors import ConfigError
from ..formats.files import write_text
from ..formats.names import safe_name
from ..formats.projects import model_folders
from ..formats.run_files import BATCH_OUTPUTS, BATCH_ROWS, is_own
from .automatic import is_photos

BARE = re.compile(r"[A-Za-z0-9_-]+")  # keys that TOML wants no quotes for
DEPTH = 3  # folders below the given one that are looked into
HEAD = """\
# The scenes of a batch. Start it with: python -m roigs_engine batch {name} --run-dir runs/{stem}
# Paths start at the folder of this file. Every option of `run` may stand in [defaults], for all
# scenes, or with one scene, which wins.

[defaults]
preset = "draft"
# max_side = 1600
# outputs = ["spz"]           # files of each result
# object_outputs = ["glb"]    # files of each object
"""


def write_table(path: Path, folder: Path) -> int:
    """Write the table of a folder's scenes; returns their number.

    Args:
        path: the table, which must not exist.
        folder: its scenes are COLMAP projects, or folders of photos, below it.

    Raises:
        ConfigError: the table exists, or the folder has no scene.
        RunFolderError: it cannot be written.
    """
    if path.exists():
        raise ConfigError(f"{path} exists.", "Choose another name, or delete it.")
    if not folder.is_dir():
        raise ConfigError(f"There is no folder {folder}.", "Give the folder of your scenes.")
    scenes = list(_scenes(folder, DEPTH))
    if not scenes:
        raise ConfigError(
            f"{folder} has no scene: no COLMAP project and no photos.",
            "Give the folder that your scenes' folders are in.",
        )
    parts = [HEAD.format(name=_shell(path.name), stem=_shell(path.stem))]
    taken: set[str] = set()
    for scene in scenes:
        name = _free_name(folder, scene, taken)
        parts.append(_row(name, scene, path.parent))
    write_text(path, "\n".join(parts))
    return len(scenes)


def _scenes(folder: Path, depth: int) -> Iterator[Path]:
    """The scenes at and below a folder, sorted; none within another."""
    if model_folders(folder) or (_has_photos(folder) and is_photos(folder)):
        yield folder
        return
    if depth:
        for child in sorted(folder.iterdir()):
            if child.is_dir() and not child.name.startswith(".") and not child.is_symlink():
                yield from _scenes(child, depth - 1)


def _has_photos(folder: Path) -> bool:
    """Whether photos are right in the folder, or in its folder `images`."""
    from ..photos.files import EXTENSIONS, HEIC

    known = EXTENSIONS | HEIC
    for place in (folder, folder / "images"):
        if place.is_dir() and any(p.suffix.lower() in known for p in place.iterdir()):
            return True
    return False


def _free_name(folder: Path, scene: Path, taken: set[str]) -> str:
    """A name for the scene's run folder: its folders' names, and a number if that is taken."""
    parts = scene.relative_to(folder).parts or (Path(os.path.abspath(scene)).name,)
    name = safe_name("-".join(parts))
    if is_own(name) or name in (BATCH_ROWS, BATCH_OUTPUTS):
        name = f"{name}-1"
    base, number = name, 1
    while name.casefold() in taken:
        number += 1
        name = f"{base}-{number}"
    taken.add(name.casefold())
    return name


def _row(name: str, scene: Path, home: Path) -> str:
    place = os.path.relpath(scene, home) if _is_near(scene, home) else os.path.abspath(scene)
    boxes = scene / "rois.json"
    lines = [
        f"[scenes.{name if BARE.fullmatch(name) else _quoted(name)}]",
        f"scene = {_quoted(Path(place).as_posix())}",
    ]
    if boxes.is_file():
        lines.append(f"rois = {_quoted((Path(place) / 'rois.json').as_posix())}")
    else:
        lines.append('roi = ["auto"]  # a box around what most photos show')
    return "\n".join([*lines, ""])


def _is_near(scene: Path, home: Path) -> bool:
    """Whether the scene lies below the table's folder."""
    return Path(os.path.abspath(scene)).is_relative_to(os.path.abspath(home))


def _quoted(text: str) -> str:
    """A TOML string; JSON's are, but for surrogates, which no TOML file can hold."""
    return json.dumps(text.encode("utf-8", "replace").decode(), ensure_ascii=False)


def _shell(name: str) -> str:
    return f'"{name}"' if " " in name else name
