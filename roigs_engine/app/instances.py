"""Reads JSON lists of models, with poses and looks (docs/files.md)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats.drawable import drawable, usable
from ..formats.files import read_json, size_read
from ..formats.names import usable_path
from ..formats.ply_rows import Check
from ..formats.splat_ply import made_of, read_ply
from ..formats.text import counted, in_gb
from ..formats.transforms import numbers
from ..machine import machine_memory

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..formats.targets import Target
    from ..model.gaussians import Gaussians
    from ..model.local_frame import LocalFrame
    from ..model.scene import Float64
    from ..rasterize.instances import Instance

HINT = "docs/files.md describes requests."
LIST = ".json"
MOST_INDEX = 2**15 - 1  # as in Blender
MOST = 2.0**20  # largest gain of a colour: 16 stops times a tint of 16
FAR = 1e15  # largest valid number in a matrix, as for boxes
COPIES = 3  # copies of all models in memory at once


class InstanceRecord(NamedTuple):
    """A model of a list."""

    file: str  # of its Gaussians
    matrix: Float64  # (4, 4) from its own world to that of the list
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)  # factors on red, green and blue
    density: float = 1.0  # above 0 and at most 1, see `faded`
    object_index: int = 0  # index of its object

    def of(self, gaussians: Gaussians, frame: LocalFrame, into: Float64 | None = None) -> Instance:
        """Return the file's model in the list's world, or in another by `into` (4, 4)."""
        from ..rasterize.instances import Instance

        return Instance(
            gaussians=gaussians,
            frame=frame,
            matrix=self.matrix if into is None else into @ self.matrix,
            gains=self.gains,
            density=self.density,
            object_index=self.object_index,
        )


def read_list(path: Path, context: Context = QUIET) -> tuple[list[InstanceRecord], Float64 | None]:
    """Read the models of a list, and (N, 4, 4) world_to_camera of its photos in the list's world.

    ConfigError: the file cannot be read, or is malformed.
    """
    record = read_json(path, ConfigError, HINT)
    try:
        photos = record.get("photos", ())
        poses = np.array([_affine(rows) for rows in photos]) if photos else None
        return instances(record, path.parent, context), poses
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise ConfigError(f"{path} is malformed ({error}).", HINT) from error


def refuse_much(wanted: Sequence[InstanceRecord]) -> None:
    """Raise ConfigError if the models, as often as each is listed, need more than the memory."""
    sizes = {name: size_read(Path(name)) for name in {item.file for item in wanted}}
    if len(wanted) > 1:
        refuse_beyond_memory(
            COPIES * sum(sizes[item.file] for item in wanted),
            f"{counted(len(wanted), 'model')} of the list need",
            "List fewer models, or smaller ones.",
        )


def refuse_beyond_memory(needed: int, what: str, advice: str) -> None:
    """Raise ConfigError if so many bytes exceed the memory; `what` is, say, "3 models need"."""
    if needed > (memory := machine_memory()):
        raise ConfigError(
            f"{what} {in_gb(needed)} of memory; this machine has {in_gb(memory)}.", advice
        )


def listed_models(path: Path) -> list[InstanceRecord]:
    """Return the models of a list, or the one of a PLY; ConfigError as for `read_list`."""
    if path.suffix.lower() == LIST:
        return read_list(path)[0]
    return [InstanceRecord(str(path), np.eye(4))]


def instances(record: Any, folder: Path, context: Context = QUIET) -> list[InstanceRecord]:
    """Return the models of a record's `models`; relative paths start at `folder`.

    TypeError, ValueError, OverflowError: it is malformed.
    """
    wanted = []
    for item in _needed(record, "models", "it"):
        context.check_cancelled()
        model = InstanceRecord(
            str(folder / usable_path(_needed(item, "ply", "a model"))),
            _affine(_needed(item, "matrix", "a model")),
            _gains(item.get("gains", (1, 1, 1))),
            _density(item.get("density", 1)),
            _object_index(item.get("object_index", 0)),
        )
        wanted.append(model)
    if not wanted:
        raise ValueError("it has no model")
    return wanted


def drawable_model(
    path: Path, say: Callable[[str], None], check: Check
) -> tuple[Gaussians, LocalFrame]:
    """Read the drawable Gaussians of a PLY, and their frame; `say` gets a line about others.

    `check` is called while reading.

    RunFolderError: the file is missing or damaged.
    """
    from ..model.gaussians import Gaussians

    stored = read_ply(path, check)
    arrays = usable(stored)
    there, kept = len(stored["means"]), len(arrays["means"])
    if kept < there:
        left_out = f"{there - kept:,} of {counted(there, 'Gaussian')}"
        say(f"{path}: {left_out} cannot be drawn (NaN, too large, or no rotation).")
    return Gaussians.framed(arrays, **made_of(path))


def as_one(
    wanted: Sequence[InstanceRecord], frame: LocalFrame, context: Context
) -> tuple[Gaussians, NDArray[np.bool_]]:
    """Merge all models in a frame; also return which rows of the files can be drawn.

    Raises:
        RunFolderError: a file is missing or damaged.
        ConfigError: nothing can be drawn, or the models need too much memory.
    """
    from ..exchange.transform import merged
    from ..model.gaussians import Gaussians

    refuse_much(wanted)
    into = np.diag([*[frame.scale] * 3, 1.0])
    into[:3, 3] = -frame.scale * frame.origin
    masks, models = [], []
    for item in wanted:
        path = Path(item.file)
        arrays = read_ply(path, context.check_cancelled)
        mask = drawable(arrays)
        masks.append(mask)
        if mask.any():
            kept, own = Gaussians.framed(usable(arrays, mask), **made_of(path))
            models.append(item.of(kept, own, into))
    if not models:
        raise ConfigError("The model has no Gaussians that can be drawn.", "Give another model.")
    model, own = merged(_alike(models))
    whole = Gaussians.from_arrays(
        model.arrays(own), target=model.target, photo_focal=model.photo_focal
    )
    return whole, np.concatenate(masks)


def _alike(models: list[Instance]) -> list[Instance]:
    """Set all models' target to that of most Gaussians.

    They are used as one model, which has one target. This hardly changes which Gaussians hide
    others.
    """
    counts: Counter[Target] = Counter()
    for model in models:
        counts[model.gaussians.target] += len(model.gaussians)
    most = max(counts, key=lambda target: (counts[target], not target.antialiased))
    return [replace(m, gaussians=replace(m.gaussians, target=most)) for m in models]


def _needed(item: Any, name: str, whose: str) -> Any:
    """Return a value of a JSON object; ValueError if it is missing."""
    if name not in item:
        raise ValueError(f"{whose} has no '{name}'")
    return item[name]


def _affine(rows: Any) -> Float64:
    """Parse a matrix of a request; ValueError unless it can be inverted."""
    matrix = numbers(rows, (4, 4), "matrix", FAR)
    if (matrix[3] != (0, 0, 0, 1)).any() or np.linalg.matrix_rank(matrix[:3, :3]) < 3:
        raise ValueError("matrix must be affine, and no scale may be zero")
    return matrix


def _gains(record: Any) -> tuple[float, float, float]:
    """Parse the gains of a request; ValueError if they are out of range."""
    red, green, blue = numbers(record, (3,), "gains").tolist()
    if not 0 <= min(red, green, blue) <= max(red, green, blue) <= MOST:
        raise ValueError(f"gains must be from 0 to {MOST:g}")
    return red, green, blue


def _density(number: Any) -> float:
    """Parse the density of a request; ValueError if it is out of range."""
    density = float(number)
    if not 0 < density <= 1:  # catches NaN too
        raise ValueError("density must be a number above 0, at most 1")
    return density


def _object_index(number: Any) -> int:
    """Parse the object index of a request; ValueError if Blender does not allow it."""
    if type(number) is not int or not 0 <= number <= MOST_INDEX:
        raise ValueError(f"object_index must be a whole number from 0 to {MOST_INDEX}")
    return number
