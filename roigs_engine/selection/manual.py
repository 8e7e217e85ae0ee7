"""Photos that the user has chosen, in the place of a method's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats.files import read_json
from ..model.roi import OrientedBox
from ..model.scene import SfmScene
from ..model.visibility import find_candidates
from .features import static_features
from .records import CameraSelection
from .score import prefix_scores

METHOD = "manual"
NAMED = 3  # photos named in a warning


def load_manual(folder: Path, rois: Sequence[OrientedBox]) -> dict[str, tuple[str, ...]]:
    """Box -> the photos listed in `folder`/ROI.json, for the boxes that have such a file.

    Of a file only `names` is looked at; a photo that is named twice counts once.

    Raises:
        ConfigError: no folder, or no file of these boxes in it.
        RunFolderError: a file cannot be read.
    """
    files = {roi.name: folder / f"{roi.name}.json" for roi in rois}
    found = {name: path for name, path in files.items() if path.is_file()}
    if not found:
        raise ConfigError(
            f"{folder} holds no selection of these ROIs.",
            f"It needs {', '.join(path.name for path in files.values())}, or some of them.",
        )
    given = {}
    for roi, path in found.items():
        record = read_json(path)
        names = record.get("names") if isinstance(record, dict) else None
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ConfigError(f"{path} holds no list 'names' of photo names.")
        given[roi] = tuple(dict.fromkeys(names))
    return given


def usable_manual(
    names: Sequence[str], scene: SfmScene, test: Sequence[str], roi: str, context: Context = QUIET
) -> tuple[str, ...]:
    """The given photos of a box that can be trained on.

    Those kept for the tests, and those of the model that cannot be used, are left out with a
    warning.

    Args:
        names: as given.
        scene: the whole scene, test photos included.
        test: the photos kept for the tests.
        roi: the box's name.
        context: gets the warnings.

    Raises:
        ConfigError: the model does not know a photo, or none is left.
    """
    held, there = set(test), {image.name for image in scene.images}
    unusable = {name for skipped in scene.skipped.values() for name in skipped}
    for name in names:
        if name not in there and name not in unusable:
            raise ConfigError(
                f"The selection of box '{roi}' names '{name}', which the scene does not have."
            )
    for reason, left_out in (
        ("kept for the tests", [name for name in names if name in held]),
        ("not usable", [name for name in names if name not in there]),
    ):
        if left_out:
            first = ", ".join(left_out[:NAMED]) + (", …" if len(left_out) > NAMED else "")
            text = f"Of the photos given for box '{roi}', {len(left_out)} are {reason} ({first})."
            context.warn(text)
    usable = tuple(name for name in names if name in there and name not in held)
    if not usable:
        raise ConfigError(
            f"None of the {len(names)} photos given for box '{roi}' can be trained on.",
            "Give others, or none to have them selected.",
        )
    return usable


def manual_selection(
    scene: SfmScene, roi: OrientedBox, names: Sequence[str], context: Context = QUIET
) -> CameraSelection:
    """The given photos as a selection, scored as the methods but `coverage` are.

    A photo that does not see the box is kept, and adds nothing to the score.
    """
    candidates = find_candidates(scene, roi, context)
    view = {name: index for index, name in enumerate(candidates.names)}
    value, scores = 0.0, []
    seeing = tuple(view[name] for name in names if name in view)
    values = iter(prefix_scores(candidates, seeing))
    for name in names:
        value = next(values) if name in view else value
        scores.append(value)
    return CameraSelection(
        roi=roi.name,
        method=METHOD,
        names=tuple(names),
        scores=tuple(scores),
        candidates=candidates.names,
        features=static_features(candidates, context).to_dict(candidates),
    )
