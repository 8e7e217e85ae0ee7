"""Manual selections: the user chooses the photos of a box."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats.files import read_json
from ..formats.text import counted, named
from ..model.roi import OrientedBox
from ..model.scene import SfmScene
from ..model.visibility import find_candidates
from .request import static_features
from .result import CameraSelection
from .score import DensityOccupancy, prefix_values

METHOD = "manual"


def load_manual(folder: Path, rois: Sequence[OrientedBox]) -> dict[str, tuple[str, ...]]:
    """Read `folder`/ROI.json of each box that has one: box -> photos.

    Reads only the list `names` of a file; a photo named twice counts once.

    Raises:
        ConfigError: the folder has no file for any of these boxes, or a file cannot be read or has
            no names.
    """
    files = {roi.name: folder / f"{roi.name}.json" for roi in rois}
    found = {name: path for name, path in files.items() if path.is_file()}
    if not found:
        raise ConfigError(
            f"{folder} has no selection for these boxes.",
            f"Add one or more of: {', '.join(path.name for path in files.values())}.",
        )
    selections, hint = {}, "Write it with `select --out`."
    for roi, path in found.items():
        record = read_json(path, ConfigError, hint)
        names = record.get("names") if isinstance(record, dict) else None
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ConfigError(f"{path} has no list 'names' of photo names.", hint)
        selections[roi] = tuple(dict.fromkeys(names))
    return selections


def usable_manual(
    names: Sequence[str], scene: SfmScene, test: Sequence[str], roi: str, context: Context = QUIET
) -> tuple[str, ...]:
    """The manually selected photos of a box that can be used for training.

    Test and validation photos (`test`) and unusable photos of the model are skipped with a warning.
    `scene` is the whole scene, test photos included.

    Raises:
        ConfigError: the model does not have a photo, or no photo is left.
    """
    test_names, usable_names = set(test), {image.name for image in scene.images}
    skipped_names = {name for skipped in scene.skipped.values() for name in skipped}
    for name in names:
        if name not in usable_names and name not in skipped_names:
            raise ConfigError(
                f"The selection of box '{roi}' names '{name}', which is not in the scene.",
                "Remove this name.",
            )
    for reason, skipped in (
        ("held out for the evaluation", [name for name in names if name in test_names]),
        ("which cannot be used", [name for name in names if name not in usable_names]),
    ):
        if skipped:
            count = counted(len(skipped), "selected photo")
            context.warn(f"Skipped {count} of box '{roi}', {reason}: {named(skipped)}.")
    usable = tuple(name for name in names if name in usable_names and name not in test_names)
    if not usable:
        raise ConfigError(
            f"The photos selected for box '{roi}' cannot be trained on.",
            "Select other photos, or remove the selection to use a method.",
        )
    return usable


def manual_selection(
    scene: SfmScene, roi: OrientedBox, names: Sequence[str], context: Context = QUIET
) -> CameraSelection:
    """The manually selected photos as a `CameraSelection`, scored by density x occupancy.

    A photo that does not see the box is kept; it does not change the score.
    """
    candidates = find_candidates(scene, roi, context)
    view = {name: index for index, name in enumerate(candidates.names)}
    value, scores = 0.0, []
    seeing = tuple(view[name] for name in names if name in view)
    values = iter(prefix_values(DensityOccupancy(candidates), seeing))
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
