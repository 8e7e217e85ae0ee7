"""PlayCanvas's SOG, version 2: a ZIP of lossless WebP pictures and a `meta.json`.

No Python package writes it, so this module does, with Pillow and scikit-learn; gsply reads it.
"""

from __future__ import annotations

import io
import json
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from sklearn.cluster import KMeans

from ..errors import ConfigError
from ..formats.files import atomic_write, read_bytes, regular
from ..formats.names import inner_path
from ..formats.ply_rows import Check, nothing
from ..machine import package
from ..model.scene import Float64
from ..photos.headers import open_picture
from .arrays import Arrays, Float32, extent, in_morton_order, opacities, unit_quats
from .compressed_ply import arrays_of
from .libraries import NotSupportedError, read_beside, refuse_bomb

TITLE = "SOG"
CODES = 256  # numbers in a codebook
BINS = 4096  # of a histogram of values
PALETTE = 65_536  # most sets of SH coefficients that Gaussians share
EACH = 5  # least mean number of Gaussians in a set
GROUPS = 256  # each is divided into sets on its own: k-means of all sets would take far longer
ACROSS = 64  # sets in a row of the picture of the palette
SAMPLE = 40_000  # rows that groups are fitted to
ROUNDS = 8  # of k-means
MOST = 50_000_000  # Gaussians
MOST_PALETTE = 1 << 24  # pixels: 65,536 sets of 15 are a million
MOST_META = 16 << 20  # bytes
MOST_FILES = 16  # names in a meta.json; the format has up to eight
META = "meta.json"
GENERATOR = "ROI-GS"
"""The `generator` in the `asset` of a `meta.json` of ours."""
ANTIALIASED = "antialiased"
"""The `model` of a `meta.json` whose Gaussians are drawn with anti-aliasing; others have none."""
COARSEST = 2e-3  # largest step of positions, of the model's size; it is still hard to see

KINDS = ("WEBP", "PNG")  # of pictures
Bytes = NDArray[np.uint8]


def write(path: Path, arrays: Arrays, *, antialiased: bool = False, check: Check = nothing) -> int:
    """See `FileFormat`; `check` is called between the parts."""
    files = files_of(arrays, check, antialiased=antialiased)
    with atomic_write(path) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as packed:
        for name, data in files.items():
            entry = zipfile.ZipInfo(name)  # with a fixed date: equal Gaussians give equal bytes
            entry.external_attr = 0o644 << 16
            packed.writestr(entry, data)
    return len(arrays["means"])


def files_of(
    arrays: Arrays, check: Check = nothing, *, antialiased: bool = False
) -> dict[str, bytes]:
    """Return name -> content of the files of a SOG, `meta.json` first; in Morton order.

    ConfigError if the model is too small or too far from the origin for SOG's positions.
    """
    _refuse_coarse(arrays["means"].astype(np.float64))
    arrays = in_morton_order(arrays)
    count, side = len(arrays["means"]), int(np.ceil(np.sqrt(len(arrays["means"]))))
    low, high, bounds = _positions(arrays["means"].astype(np.float64))
    weights = _weights(arrays)
    scales, scale_codes = _coded(arrays["log_scales"].astype(np.float32), weights)
    check()
    colours, colour_codes = _coded(arrays["sh"][:, 0].astype(np.float32), weights)
    alpha = np.clip(np.round(opacities(arrays) * 255), 0, 255).astype(np.uint8)
    pictures = {
        "means_l.webp": _square(low, side),
        "means_u.webp": _square(high, side),
        "scales.webp": _square(scales, side),
        "quats.webp": _square(_rotations(unit_quats(arrays)), side),
        "sh0.webp": _square(np.column_stack((colours, alpha)), side),
    }
    meta: dict[str, Any] = {
        "version": 2,
        "asset": {"generator": GENERATOR},
        **({"model": ANTIALIASED} if antialiased else {}),
        "count": count,
        "means": bounds | {"files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scale_codes, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colour_codes, "files": ["sh0.webp"]},
    }
    bands = arrays["sh"].shape[1]
    if bands > 1:
        higher = arrays["sh"][:, 1:].astype(np.float32)
        labels, centroids, codes, used = _palette(higher, weights, check)
        pictures["shN_centroids.webp"] = centroids
        pictures["shN_labels.webp"] = _square(labels, side)
        meta["shN"] = {
            "count": used,
            "bands": int(np.sqrt(bands)) - 1,
            "codebook": codes,
            "files": ["shN_centroids.webp", "shN_labels.webp"],
        }
    files = {META: json.dumps(meta).encode()}
    for name, data in pictures.items():
        check()
        files[name] = _webp(data)
    return files


def _refuse_coarse(means: Float64) -> None:
    """Raise ConfigError if readers, which compute in float32, would move Gaussians visibly."""
    distance = np.median(np.abs(means).max(axis=1))
    step = float(np.finfo(np.float32).eps) * (1 + distance) * (1 + np.log1p(distance))
    if step > COARSEST * extent(means) > 0:
        raise ConfigError(
            "The model is too small, or too far from the origin, for SOG.",
            "Scale it to a size of a few units around the origin, or use another format.",
        )


def _weights(arrays: Arrays) -> Float32:
    """Return weights (N,): roughly how visible each Gaussian is, 1 on average."""
    sizes = np.sort(arrays["log_scales"].astype(np.float64), axis=1)
    area = np.exp(np.clip((sizes[:, 1] + sizes[:, 2]) / 2, -30, 30))
    seen = opacities(arrays) * area
    return np.asarray(np.maximum(seen / max(float(seen.mean()), 1e-30), 1e-3).astype(np.float32))


def _positions(means: NDArray[np.float64]) -> tuple[Bytes, Bytes, dict[str, list[float]]]:
    """Return the low and high bytes (N, 3) of positions on a logarithmic scale, and its bounds."""
    values = np.sign(means) * np.log1p(np.abs(means))
    low, high = values.min(axis=0), values.max(axis=0)
    steps = np.round((values - low) / np.maximum(high - low, 1e-30) * 65535).astype(np.uint16)
    bounds = {"mins": low.tolist(), "maxs": high.tolist()}
    return (steps & 255).astype(np.uint8), (steps >> 8).astype(np.uint8), bounds


def _rotations(quats: Float32) -> Bytes:
    """Return (N, 4): the three smallest numbers of each quaternion, and which one is left out."""
    largest = np.abs(quats).argmax(axis=1)
    rows = np.arange(len(quats))
    quats = quats * np.where(quats[rows, largest] < 0, -1, 1)[:, None]
    others = np.array([[k for k in range(4) if k != left] for left in range(4)])[largest]
    three = np.take_along_axis(quats, others, axis=1) * np.sqrt(2)
    coded = np.clip(np.round((three * 0.5 + 0.5) * 255), 0, 255)
    return np.column_stack((coded, 252 + largest)).astype(np.uint8)


def _coded(values: Float32, weights: Float32 | None = None) -> tuple[Bytes, list[float]]:
    """Return the indices of values (N, ...) in a codebook, and the codebook; `weights` are (N,)."""
    if weights is None:
        weights = np.ones(len(values), np.float32)
    each = np.repeat(weights, values[0].size)
    codes = _codebook(values.reshape(-1).astype(np.float64), each.astype(np.float64))
    middles = (codes[1:] + codes[:-1]) / 2
    return np.searchsorted(middles, values).astype(np.uint8), codes.tolist()


def _codebook(values: Float64, weights: Float64) -> Float64:
    """Return (CODES,) sorted numbers that represent all values: a one-dimensional k-means.

    Its first codes are as dense as the cube root of the values' density, which is best for many
    codes. With quantiles, the few large values would get hardly any.
    """
    order = np.argsort(values)
    ordered, weights = values[order], weights[order]
    density, edges = np.histogram(ordered, BINS, weights=weights)
    reached = np.concatenate(([0.0], np.cumsum(np.cbrt(density))))
    codes: Float64 = np.interp((np.arange(CODES) + 0.5) / CODES * reached[-1], reached, edges)
    codes[0], codes[-1] = ordered[0], ordered[-1]
    sums = np.concatenate(([0.0], np.cumsum(ordered * weights)))
    counts = np.concatenate(([0.0], np.cumsum(weights)))
    for _ in range(20):
        cuts = np.searchsorted(ordered, (codes[1:] + codes[:-1]) / 2)
        ends = np.concatenate(([0], cuts, [len(ordered)]))
        number = np.diff(counts[ends])
        means = np.diff(sums[ends]) / np.maximum(number, 1e-30)
        codes = np.sort(np.where(np.diff(ends) > 0, means, codes))
    return codes


def _palette(sh: Float32, weights: Float32, check: Check) -> tuple[Bytes, Bytes, list[float], int]:
    """Return labels (N, 3), the picture of the palette, its codebook, and its number of sets.

    `sh` (N, K, 3) are the coefficients above degree 0; for `weights` (N,), see `_weights`.
    """
    rows = sh.reshape(len(sh), -1)
    labels, centres = _clusters(rows, weights, check)
    used, bands = len(centres), sh.shape[1]
    numbers, codes = _coded(centres)
    picture = np.zeros((-(-used // ACROSS) * ACROSS, bands, 3), np.uint8)
    picture[:used] = numbers.reshape(used, bands, 3)
    centroids = picture.reshape(-1, ACROSS * bands, 3)
    split = np.column_stack((labels & 255, labels >> 8, np.zeros_like(labels)))
    return split.astype(np.uint8), centroids, codes, used


def _clusters(rows: Float32, weights: Float32, check: Check) -> tuple[NDArray[np.int64], Float32]:
    """Return the set of each row (N,), and the sets (at most PALETTE, D): k-means in two steps.

    First, rows are divided into groups. Then each group gets a number of sets in proportion to its
    rows times their weighted standard deviation.
    """
    random = np.random.default_rng(0)
    wanted = int(np.clip(len(rows) // EACH, 1, PALETTE))
    sample = random.permutation(len(rows))[:SAMPLE]
    groups = min(GROUPS, wanted)
    group = _means(rows[sample], weights[sample], groups).predict(rows)
    members = [np.flatnonzero(group == k) for k in range(groups)]
    deviations = np.array([_deviation(rows[m], weights[m]) for m in members])
    shares = np.array([len(m) for m in members]) * deviations
    sizes = (shares / max(shares.sum(), 1e-30) * (wanted - groups)).astype(int) + 1
    labels = np.zeros(len(rows), np.int64)
    centres: list[Float32] = []
    there = 0
    for member, size in zip(members, sizes, strict=True):
        check()
        if len(member):
            found = _means(rows[member], weights[member], min(size, len(member)))
            labels[member] = found.labels_ + there
            centres.append(found.cluster_centers_.astype(np.float32))
            there += len(centres[-1])
    return labels, np.concatenate(centres)


def _deviation(rows: Float32, weights: Float32) -> float:
    """Return the root of the mean weighted square of distances from the mean."""
    if not len(rows):
        return 0.0
    return float(np.sqrt((np.square(rows - rows.mean(axis=0)).sum(axis=1) * weights).mean()))


def _means(rows: Float32, weights: Float32, sets: int) -> Any:
    start = np.random.default_rng(0).permutation(len(rows))[:sets]
    model = KMeans(len(start), init=rows[start], n_init=1, max_iter=ROUNDS)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about fewer different rows than sets
        return model.fit(rows, sample_weight=weights)


def _square(values: Bytes, side: int) -> Bytes:
    """Return a picture (side, side, 3 or 4) with one Gaussian in each pixel."""
    picture = np.zeros((side * side, values.shape[1]), np.uint8)
    picture[: len(values)] = values
    return picture.reshape(side, side, -1)


def _webp(picture: Bytes) -> bytes:
    out = io.BytesIO()
    Image.fromarray(picture).save(out, "WEBP", lossless=True, exact=True, quality=100, method=4)
    return out.getvalue()


def read(path: Path) -> Arrays:
    """See `FileFormat`. The file is a .sog, or a `meta.json` with its pictures beside it."""
    gsply: Any = package("gsply", TITLE)
    package("imagecodecs", TITLE)  # gsply needs it
    data = _packed(path)
    _check(data)
    return arrays_of(gsply.sogread(data))


def is_antialiased(path: Path) -> bool:
    """Whether a file records that its Gaussians are drawn with anti-aliasing."""
    if path.name.lower() == META:
        meta = json.loads(read_bytes(path, most=None)[:MOST_META])
    else:
        with (
            open(path, "rb", opener=regular) as whole,
            zipfile.ZipFile(whole) as packed,
            packed.open(META) as file,
        ):
            meta = json.loads(file.read(MOST_META))
    return bool(meta.get("model") == ANTIALIASED)


def _packed(path: Path) -> bytes:
    """Return the bytes of a .sog; a `meta.json` and the files it names are packed into one."""
    data = read_bytes(path, most=None)
    if path.name.lower() != META:
        return data
    meta = json.loads(data[:MOST_META])
    parts = [part for part in meta.values() if isinstance(part, dict)]
    names = {str(name) for part in parts for name in part.get("files", [])} - {META}
    if len({inner_path(name) for name in names}) < len(names) or len(names) > MOST_FILES:
        raise ValueError("a file under two names, or too many files")
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as packed:
        packed.writestr(META, data)
        for name in sorted(names):
            packed.writestr(name, read_beside(path, name))
    return out.getvalue()


def _check(data: bytes) -> None:
    """Check `meta.json`, which gsply trusts, against the pictures."""
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        sizes = {entry.filename: entry.file_size for entry in packed.infolist()}
        if len(sizes) < len(packed.infolist()) or sizes.get(META, 0) > MOST_META:
            raise ValueError("two entries of one name, or a meta.json of another kind")
        refuse_bomb(len(data), sum(sizes.values()))
        meta = json.loads(packed.read(META))
        if meta.get("version", 2) != 2:
            raise NotSupportedError(f"version {meta['version']!s:.10} of SOG")
        parts = [meta[name] for name in ("means", "scales", "quats", "sh0")]
        count = meta["count"] if "version" in meta else meta["means"]["shape"][0]
        if type(count) is not int or not 0 < count <= MOST:
            raise ValueError(f"{count} Gaussians")
        names = [name for part in parts for name in part["files"]]
        if "shN" in meta:
            names.append(meta["shN"]["files"][1])
            sets = meta["shN"].get("count", 1)
            if type(sets) is not int or not 0 < sets <= MOST_PALETTE:
                raise ValueError("a palette of another kind")
        if len(names) > MOST_FILES:
            raise ValueError(f"it names {len(names):,} pictures")
        refuse_bomb(len(data), 4 * count * len(names))
        for name in names:
            if not count <= _pixels(packed, name) <= 4 * count + (1 << 16):
                raise ValueError(f"{name} does not belong to {count} Gaussians")
        _check_numbers(meta)
        if "shN" in meta and _pixels(packed, meta["shN"]["files"][0]) > MOST_PALETTE:
            raise ValueError("a palette that is too large")


def _pixels(packed: zipfile.ZipFile, name: str) -> int:
    """Return the number of pixels of a picture in the archive."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # Pillow's, of pictures that are far too large
        picture = open_picture(packed.read(name), KINDS)
        return picture.width * picture.height


def _check_numbers(meta: dict[str, Any]) -> None:
    """Raise ValueError unless lists of numbers have the lengths that compiled code assumes."""
    lists = [(meta["means"][name], 3) for name in ("mins", "maxs")]
    if "version" in meta:
        parts = [meta[name] for name in ("scales", "sh0", "shN") if name in meta]
        lists += [(part["codebook"], CODES) for part in parts]
    else:
        lists += [(meta["scales"][name], 3) for name in ("mins", "maxs")]
        lists += [(meta["sh0"][name], 4) for name in ("mins", "maxs")]
    for numbers, length in lists:
        if np.array(numbers, np.float64).shape != (length,):
            raise ValueError(f"a list that has not {length} numbers")
