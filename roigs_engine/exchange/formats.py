"""Table of the file formats of Gaussians, by suffix."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ConfigError, RunFolderError
from ..formats import splat_ply
from ..formats.drawable import usable
from ..formats.files import regular
from ..formats.ply_rows import Check, nothing
from ..formats.targets import PLAIN, Target, target_with
from ..model.scene import Float64
from .arrays import Arrays, extent, flaw, upright
from .libraries import CONVERT, HINT, reading

FAR = 1e4
"""Distance from the origin, in sizes of the model, from which float32 moves Gaussians visibly."""

COMPRESSED, HEADER = ".compressed.ply", 1024
"""Suffix of compressed PLYs, and bytes of a PLY that say whether it is one."""


@dataclass(frozen=True, kw_only=True)
class FileFormat:
    """A file format of Gaussians.

    Its module has `write(path, arrays)`, which returns the number of Gaussians written, and
    `read(path)`. Any error of `read` but NotSupportedError means a damaged file. Both raise
    ConfigError if the format cannot store the model, and EngineError if a package is missing. With
    `keeps_antialiased`, `write` takes `antialiased`, and a module that reads has `is_antialiased`;
    PLYs record the whole target instead.
    """

    title: str  # the usual name
    suffix: str  # of a file's name
    up: str  # the up axis of most of its readers
    module: str = ""  # of this package; empty: the plain PLY
    reads: bool = True
    says_axes: bool = False  # whether its module has `frame`, because a file may name other axes
    checks: bool = False  # whether its `write` takes `check`, because it takes long
    keeps_antialiased: bool = True  # whether a file records if it is for anti-aliasing

    @property
    def code(self) -> Any:
        """Return the format's module."""
        return import_module(f".{self.module}", __package__)

    @property
    def keeps_target(self) -> bool:
        """Whether a file records the target of its Gaussians, linear light included."""
        return self.suffix.endswith(".ply")


PAGE = ".html"
USD = FileFormat(
    title="OpenUSD", suffix=".usdc", up="y", module="usd", says_axes=True, keeps_antialiased=False
)
FORMATS = (
    FileFormat(title="compressed PLY", suffix=COMPRESSED, up="-y", module="compressed_ply"),
    FileFormat(title="PLY", suffix=".ply", up="-y"),
    FileFormat(title="SPZ", suffix=".spz", up="y", module="spz", checks=True, says_axes=True),
    FileFormat(title="SOG", suffix=".sog", up="-y", module="sog", checks=True),
    FileFormat(title="glTF", suffix=".glb", up="y", module="gltf", keeps_antialiased=False),
    USD,
    replace(USD, suffix=".usda"),
    replace(USD, suffix=".usdz"),
    FileFormat(title=".splat", suffix=".splat", up="-y", module="splat", keeps_antialiased=False),
    FileFormat(title="web page", suffix=PAGE, up="y", module="page", reads=False),
)

READ_ONLY = (
    FileFormat(title="SOG", suffix="meta.json", up="-y", module="sog"),
    FileFormat(title="glTF", suffix=".gltf", up="y", module="gltf", keeps_antialiased=False),
    replace(USD, suffix=".usd"),
)
"""Other formats that are only read. A `suffix` without a leading dot is the whole name."""

OTHERS = {
    ".ksplat": "GaussianSplats3D",
    ".splatv": "antimatter15, with motion",
    ".lcc": "XGRIDS",
    ".lcc2": "XGRIDS",
    ".rad": "Spark",
    ".licht": "LichtFeld Studio",
    ".ssog": "LichtFeld Studio",
    ".nurec": "NVIDIA",
    ".b3dm": "3D Tiles",
    ".3tz": "3D Tiles",
    ".ckpt": "nerfstudio",
    ".pth": "a checkpoint",
    ".pt": "a checkpoint",
    "lod-meta.json": "a Streamed SOG; each of its folders has a meta.json",
}
"""Ends of names of other files of Gaussians -> what these are."""


def is_named(path: Path) -> bool:
    """Whether a JSON file's name is one of `format_of` or `OTHERS`, so that it is no list."""
    return path.name.lower() in {"meta.json", "lod-meta.json"}


def format_of(path: Path) -> FileFormat:
    """Return the format of a file by its name; ConfigError if the name has no known one."""
    name = path.name.lower()
    for form in (*FORMATS, *READ_ONLY):
        if name == form.suffix if form.suffix[0] != "." else name.endswith(form.suffix):
            return form
    for ending, what in OTHERS.items():
        if name.endswith(ending):
            raise ConfigError(f"{path}: {ending} ({what}) is not supported.", CONVERT)
    known = ", ".join(form.suffix for form in FORMATS)
    raise ConfigError(f"{path} is not the name of a file of Gaussians.", f"Use {known}.")


def writable(path: Path) -> FileFormat:
    """Do the same as `format_of`; ConfigError also if files of that format are only read."""
    form = format_of(path)
    if form in READ_ONLY:
        known = ", ".join(form.suffix for form in FORMATS)
        raise ConfigError(f"{path}: {form.suffix} is read-only.", f"Write {known}.")
    return form


def write(
    path: Path,
    arrays: Arrays,
    check: Check = nothing,
    *,
    target: Target = PLAIN,
    photo_focal: float | None = None,
    **more: Any,
) -> int:
    """Write a file of Gaussians in the format of its name, whole or not at all; return how many.

    Args:
        path, arrays: the file, and the model.
        check: called between the parts of long work; if it raises, no file is written.
        target, photo_focal: how the Gaussians were made (`splat_ply.Made`); written as far as the
            format can record it.
        more: other arguments of the module's `write`; none for a plain PLY.
    """
    form = writable(path)
    if not form.module:
        splat_ply.write_ply(path, arrays, target, photo_focal=photo_focal)
        return len(arrays["means"])
    arrays = storable(arrays, form.title)
    if form.checks:
        more["check"] = check
    if form.keeps_target:
        more["target"] = target
    elif form.keeps_antialiased:
        more["antialiased"] = target.antialiased
    return int(form.code.write(path, arrays, **more))


def storable(arrays: Arrays, title: str) -> Arrays:
    """Return the Gaussians that can be drawn; ConfigError if there are none, or if too far away."""
    arrays = usable(arrays)
    if not len(arrays["means"]):
        raise ConfigError("The model has no Gaussians that can be drawn.", "Give another model.")
    means = arrays["means"].astype(np.float64)
    if np.abs(np.median(means, axis=0)).max() > FAR * extent(means) > 0:
        raise ConfigError(
            f"The model is too far from the origin for {title}.",
            "Move it to the origin, or write a plain PLY.",
        )
    return arrays


def read(path: Path, check: Check = nothing) -> Arrays:
    """Read a file of Gaussians in the format of its name; ConfigError if that is only written.

    `check` is called while a plain PLY is read, because it may be large.
    """
    form = _readable(path)
    if not form.module:
        with suppress(OSError), open(path, "rb", opener=regular) as file:  # the reader raises it
            if b"\nelement chunk " in file.read(HEADER):  # whatever its name says
                form = format_of(Path(COMPRESSED))
    if not form.module:
        return splat_ply.read_ply(path, check)
    code = form.code
    with reading(path, form.title):
        found: Arrays = code.read(path)
        if problem := flaw(found):
            raise ValueError(problem)
    arrays = usable(found)
    if not len(arrays["means"]):
        raise RunFolderError(f"{path} has no Gaussians that can be drawn.", HINT)
    return arrays


def target_of(path: Path) -> Target:
    """Return the target of a file's Gaussians, `PLAIN` if the file records none."""
    form = _readable(path)
    if not form.keeps_antialiased:
        return PLAIN
    if form.keeps_target:  # both kinds of PLYs record it alike
        return splat_ply.target_of(path)
    code = form.code
    with reading(path, form.title):
        return target_with(antialiased=code.is_antialiased(path))


def photo_focal_of(path: Path) -> float | None:
    """Return the focal length of the photos of a file's Gaussians (`Gaussians`), or None."""
    return splat_ply.photo_focal_of(path) if _readable(path).keeps_target else None


def frame(path: Path) -> Float64:
    """Return (4, 4) from a file's axes to those of its format; no change if it names no others."""
    form, matrix = _readable(path), np.eye(4)
    if form.suffix.endswith(".ply"):
        if (up := splat_ply.up_axis(path)) is not None:
            matrix = upright(np.array(up), form.up)
    elif form.says_axes:
        code = form.code
        with reading(path, form.title):
            matrix[:3, :3] = code.frame(path)
    return matrix


def common_target(targets: Mapping[Path, Target]) -> Target:
    """Return the common target of files that are merged, `PLAIN` for no files.

    ConfigError if the targets differ, because no file can record that.
    """
    first: dict[Target, Path] = {}
    for path, target in targets.items():
        first.setdefault(target, path)
    if len(first) > 1:
        (target, path), (other, second) = list(first.items())[:2]
        raise ConfigError(
            f"{path} is made for {target.title}, {second} for {other.title}.",
            "Write each into its own file, or adapt one first (`adapt`; --plain for viewers "
            "without anti-aliasing).",
        )
    return next(iter(first), PLAIN)


def _readable(path: Path) -> FileFormat:
    """Return the format of a file; ConfigError if it cannot be read."""
    form = format_of(path)
    if not form.reads:
        raise ConfigError(f"{form.title} files cannot be read.", "Give one of another format.")
    return form
