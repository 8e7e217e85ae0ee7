"""The 3DGS PLY layout, which every splat viewer reads; numpy only.

Files are written in binary little-endian; ASCII and big-endian are read, too.

docs/conventions.md has the layout. Writing and reading keep values bit for bit. Centres far from
the origin, as in map coordinates, are `double x y z`, because float32 would be too coarse there.

docs/formats.md (Made for) describes how files, ours and other programs', record anti-aliasing and
light.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from ..errors import RunFolderError
from .files import atomic_write
from .ply_rows import HINT, Check, header_lines, nothing, vertex_rows
from .targets import PLAIN, TARGETS, Target, target_with

Float32 = NDArray[np.float32]
Floats = NDArray[np.float32] | NDArray[np.float64]
REST_SIZES = {3 * ((degree + 1) ** 2 - 1) for degree in range(8)}
"""Valid numbers of `f_rest` columns, one for each SH degree."""
MOST_BANDS = 16  # SH coefficients kept for each colour channel: up to degree 3
SH_C0 = 0.28209479177387814  # SH basis function of degree 0
LEAST_FOCAL, MOST_FOCAL = 1.0, 1e7  # pixels
ANTIALIASED = "comment SplatRenderMode: mip"
"""Header line of Gaussians that are drawn with anti-aliasing."""
# Whole lines of `header_lines`, which have single spaces: so a search takes linear time.
RENDER_MODE = re.compile(
    rb"comment (?:splatrendermode: ?(mip|default)|antialiased ([01]))", re.IGNORECASE
)
PHOTO_FOCAL = re.compile(rb"comment photo_focal ([0-9.e+-]{1,40})")
MADE_FOR = re.compile(rb"comment made_for (\w+)")
UP_AXIS = re.compile(rb"comment (?:vertical|up)[ _-]*axis ?[:=]? ?(.*)", re.IGNORECASE)
"""`Vertical Axis: z` of nerfstudio, `Vertical axis: y` or `Vertical axis: X Y Z` of Brush."""
RGB = ("red", "green", "blue")
FILTER = "filter_3D"
"""Property of Mip-Splatting: standard deviation of the blur in space."""
FILTER_LINE = re.compile(rb"property \S+ " + FILTER.encode())


class Made(TypedDict):
    """How Gaussians were made, where this affects drawing."""

    target: Target
    photo_focal: float | None  # of the training photos, pixels; None: unknown


def _columns(rest: int) -> list[str]:
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{k}" for k in range(rest)]
    names += ["opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
    return names


def write_ply(
    path: Path,
    arrays: Mapping[str, Floats],
    target: Target = PLAIN,
    *,
    photo_focal: float | None = None,
    more: Mapping[str, Float32] | None = None,
    durable: bool = True,
) -> None:
    """Write Gaussians to `path` atomically.

    Args:
        path: the file to write.
        arrays: `means` (N, 3), float32 or float64 (written as double); float32 `quats` (N, 4),
            `log_scales` (N, 3), `logit_opacities` (N,), `sh` (N, K, 3) with K = 1, 4, 9 or 16.
        target, photo_focal: as in `Made`.
        more: further float properties, name -> (N,); viewers ignore them.
        durable: as in `atomic_write`.
    """
    sh, more = arrays["sh"], more or {}
    count, bands = sh.shape[:2]
    rest = 3 * (bands - 1)
    names = [*_columns(rest), *more]
    table = np.zeros((count, len(names)), dtype="<f4")
    for place, name in enumerate(more, start=len(names) - len(more)):
        table[:, place] = more[name]
    means = arrays["means"]
    table[:, 0:3] = means
    table[:, 6:9] = sh[:, 0]
    table[:, 9 : 9 + rest] = sh[:, 1:].transpose(0, 2, 1).reshape(count, rest)
    shape = table[:, 9 + rest : 17 + rest]
    shape[:, 0] = arrays["logit_opacities"]
    shape[:, 1:4] = arrays["log_scales"]
    shape[:, 4:] = arrays["quats"]
    header = ["ply", "format binary_little_endian 1.0"]
    header += [*made_lines(target, photo_focal), f"element vertex {count}"]
    types = dict.fromkeys(names, "float")
    rows: NDArray[Any] = table
    if means.dtype == np.float64:
        types |= dict.fromkeys(("x", "y", "z"), "double")
        rows = np.empty(count, [("means", "<f8", 3), ("others", "<f4", len(names) - 3)])
        rows["means"], rows["others"] = means, table[:, 3:]
    header += [f"property {types[name]} {name}" for name in names] + ["end_header", ""]
    with atomic_write(path, durable=durable) as file:
        file.write("\n".join(header).encode("ascii"))
        file.write(rows.data)


def made_lines(target: Target, photo_focal: float | None = None) -> list[str]:
    """The lines of a PLY's header that say how its Gaussians were made."""
    lines = [ANTIALIASED] if target.antialiased else []
    lines += [f"comment made_for {target.name}"] if target.linear_light else []
    return lines if photo_focal is None else [*lines, f"comment photo_focal {photo_focal!r}"]


def made_of(path: str | Path) -> Made:
    """How a PLY's Gaussians were made; raises as `target_of`."""
    head = header_lines(path)
    return {"target": _target(head), "photo_focal": _photo_focal(head)}


def photo_focal_of(path: str | Path) -> float | None:
    """The focal length of a PLY's training photos, if recorded; raises as `target_of`."""
    return _photo_focal(header_lines(path))


def _photo_focal(head: list[bytes]) -> float | None:
    said = _matches(PHOTO_FOCAL, head)
    with suppress(ValueError):
        return usable_focal(float(said[-1][1])) if said else None
    return None


def _matches(pattern: re.Pattern[bytes], head: list[bytes]) -> list[re.Match[bytes]]:
    """The lines that match as a whole."""
    return [match for line in head if (match := pattern.fullmatch(line))]


def usable_focal(value: float) -> float | None:
    """Return a focal length in pixels if photos can have it, else None."""
    return value if LEAST_FOCAL <= value <= MOST_FOCAL else None


def read_ply(path: str | Path, check: Check = nothing) -> dict[str, Floats]:
    """Read the arrays of `write_ply` by property name.

    `means` is float64 if the file has double `x y z`; everything else is float32. Normals may be
    missing. SH may have any degree up to 7; bands above degree 3 are dropped.
    Colours may be bytes `red green blue`, as nerfstudio writes them with `--ply-color-mode rgb`.
    Mip-Splatting's `filter_3D` is applied; other extra properties and elements are ignored.
    `check` is called while reading.

    Raises:
        RunFolderError: the file is missing, truncated, or not a PLY of Gaussians.
    """
    parts = []
    for rows in vertex_rows(path, check):
        check()
        parts.append(_decode(rows, path))
    if len(parts) == 1:
        return parts[0]
    # Free each array's parts once they are joined: a file may fill half of the memory.
    names = list(parts[0])
    return {name: np.concatenate([part.pop(name) for part in parts]) for name in names}


def up_axis(path: str | Path) -> tuple[float, float, float] | None:
    """The up direction that a PLY's comments state (compressed or not); None: they state none.

    RunFolderError: it cannot be read.
    """
    found = None
    for said in _matches(UP_AXIS, header_lines(path)):
        text = said[1].decode("ascii", "replace").lower()
        if match := re.fullmatch(r"([+-]?)([xyz])(?:[ _-]*(?:up|axis))?", text):
            found = [0.0, 0.0, 0.0]
            found["xyz".index(match[2])] = -1.0 if match[1] == "-" else 1.0
        elif re.fullmatch(r"[(\[]?" + r"[ ,]+".join([r"([-+.\de]+)"] * 3) + r"[)\]]?", text):
            found = None
            with suppress(ValueError):
                numbers = [float(word) for word in re.split(r"[ ,]+", text.strip("()[]"))]
                if 1e-6 < np.linalg.norm(numbers) < 1e6:  # not NaN either
                    found = numbers
    return None if found is None else (found[0], found[1], found[2])


def target_of(path: str | Path) -> Target:
    """The target of a PLY's Gaussians, compressed or not, if the file records it.

    RunFolderError: it cannot be read.
    """
    return _target(header_lines(path))


def _target(head: list[bytes]) -> Target:
    named = [TARGETS.get(line[1].decode("ascii", "replace")) for line in _matches(MADE_FOR, head)]
    if named and named[-1]:
        return named[-1]
    said = [line[1] or line[2] for line in _matches(RENDER_MODE, head)]
    if not said:
        return target_with(antialiased=bool(_matches(FILTER_LINE, head)))
    return target_with(antialiased=said[-1].lower() in (b"mip", b"1"))


def check_ply(path: str | Path) -> None:
    """Check only the header and the size of the file; raises as `read_ply`."""
    _decode(next(vertex_rows(path, nothing, only_header=True)), path)


def _decode(table: NDArray[np.void], path: str | Path) -> dict[str, Floats]:
    names = table.dtype.names or ()
    rest = sum(name.startswith("f_rest_") for name in names)
    if rest not in REST_SIZES:
        raise RunFolderError(f"{path} is not a Gaussian PLY ({rest} properties f_rest).", HINT)
    base = [f"f_dc_{c}" for c in range(3)]
    painted = base[0] not in names and set(RGB) <= set(names) and not rest
    missing = [n for n in _columns(rest) if n not in names and not n.startswith("n")]
    missing = [name for name in missing if not (painted and name in base)]
    if missing == ["scale_2"]:
        text = f"{path} has 2D Gaussians (scale_0 and scale_1 alone), which are not supported."
        raise RunFolderError(text, HINT)
    if missing:
        raise RunFolderError(f"{path} is not a Gaussian PLY (no property {missing[0]}).", HINT)
    # One gather of a plain matrix is several times faster than one pass per column.
    plain = all(table.dtype[name] == np.dtype("<f4") for name in names)
    matrix = table.view("<f4").reshape(len(table), len(names)) if plain else None

    def columns(wanted: list[str]) -> Float32:
        if matrix is not None:
            return matrix[:, [names.index(name) for name in wanted]]
        return np.stack([table[name].astype(np.float32) for name in wanted], axis=1)

    # The file has all of red, then green, then blue. Here, a coefficient's colours are adjacent.
    bands = min(1 + rest // 3, MOST_BANDS)
    sh = base + [f"f_rest_{c * (rest // 3) + k}" for k in range(bands - 1) for c in range(3)]
    means: Floats = columns(["x", "y", "z"])
    if any(table.dtype[name].itemsize == 8 for name in "xyz"):
        means = np.stack([table[name].astype(np.float64) for name in "xyz"], axis=1)
    log_scales = columns([f"scale_{k}" for k in range(3)])
    logit_opacities = columns(["opacity"])[:, 0]
    if FILTER in names:
        blur = columns([FILTER])[:, 0]
        log_scales, logit_opacities = _blurred(log_scales, logit_opacities, blur)
    if painted:  # colours as bytes, or as numbers from 0 to 1
        bytes_ = [table[name].dtype.kind != "f" for name in RGB]
        colours = (columns([*RGB]) / np.where(bytes_, 255, 1) - 0.5) / SH_C0
    else:
        colours = columns(sh)
    return {
        "means": means,
        "quats": columns([f"rot_{k}" for k in range(4)]),
        "log_scales": log_scales,
        "logit_opacities": logit_opacities,
        "sh": colours.astype(np.float32, copy=False).reshape(len(table), bands, 3),
    }


def _blurred(
    log_scales: Float32, logit_opacities: Float32, blur: Float32
) -> tuple[Float32, Float32]:
    """Log scales (N, 3) and opacity logits (N,) after a blur in space (N,), world units.

    Mip-Splatting's 3D smoothing filter (Yu et al. 2024, sec. 5.1), as its renderer applies it: the
    opacity falls as the volume grows, so the integral does not change.
    """
    log_scales, logit_opacities = log_scales.copy(), logit_opacities.copy()
    rows = blur != 0  # the others do not change, not even flat ones
    before, logits = (a[rows].astype(np.float64) for a in (log_scales, logit_opacities))
    with np.errstate(all="ignore"):  # NaN stays NaN; the logarithm of an opacity of 0 is -Inf
        own = np.log(np.abs(blur[rows].astype(np.float64)))
        after = np.logaddexp(2 * before, 2 * own[:, None]) / 2
        opacity = (before - after).sum(axis=1) - np.logaddexp(0, -logits)  # its logarithm
        logit_opacities[rows] = opacity - np.log(-np.expm1(opacity))
    log_scales[rows] = after
    return log_scales, logit_opacities
