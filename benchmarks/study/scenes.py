"""The scenes of a study: a COLMAP project and its boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from roigs_engine.errors import ConfigError
from roigs_engine.model.roi import OrientedBox, load_rois


@dataclass(frozen=True, kw_only=True, eq=False)
class StudyScene:
    """A COLMAP project and its boxes, all of which are trained together."""

    name: str
    path: Path
    rois: list[OrientedBox]


def parse_scenes(texts: Sequence[str]) -> list[StudyScene]:
    """Scenes written as `PATH`, with a rois.json in it, or as `PATH:ROIS.json`.

    A scene has the name of its folder, or NAME if it is written as `NAME=PATH`.

    Raises:
        ConfigError: two have one name.
        RoiError, RunFolderError: the boxes cannot be read.
    """
    scenes = [_scene(text) for text in texts]
    names = [scene.name for scene in scenes]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"Two scenes are named '{name}'.", "Rename the folder of one.")
    return scenes


def _scene(text: str) -> StudyScene:
    name, separator, place = text.partition("=")
    if not separator or Path(text).exists():
        name, place = "", text
    path, rois = Path(place), Path(place) / "rois.json"
    if not path.exists() and ":" in place:
        before, _, after = place.rpartition(":")
        path, rois = Path(before), Path(after)
    return StudyScene(name=name or path.resolve().name, path=path, rois=load_rois(rois))
