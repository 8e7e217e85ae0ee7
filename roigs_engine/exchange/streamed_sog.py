"""PlayCanvas's Streamed SOG: levels of detail, of which a viewer loads only those it needs.

`lod-meta.json` lists parts with their bounds, and for each level of a part the folder of a SOG. The
folder's name has a hash of its files. So writing a new model changes no file of the old one, and
the old `lod-meta.json` stays valid until the new one replaces it.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from ..errors import RunFolderError
from ..formats.files import (
    is_link,
    matching,
    own_folder,
    read_json,
    read_record,
    remove_leftovers,
    write_bytes,
    write_json,
)
from ..formats.lock import locked
from ..formats.ply_rows import Check, nothing
from . import sog
from .arrays import Arrays
from .formats import storable

NAME = "lod-meta.json"
TITLE = "Streamed SOG"
DIGITS = 16  # of the hash in a folder's name
FOLDER = re.compile(rf"\d+_\d+-[0-9a-f]{{{DIGITS}}}")
"""Level, part and hash."""
LOCK = "lod-meta.lock"


def write(
    path: Path,
    parts: Sequence[Sequence[Arrays]],
    check: Check = nothing,
    *,
    antialiased: bool = False,
) -> int:
    """Write a model into the folder of `path`; return the number of Gaussians of the whole model.

    At the end, folders of ours that no `lod-meta.json` names are deleted: those of the model that
    this one replaces, or, after an error, the new one's.

    Args:
        path: the `lod-meta.json` (`NAME`), written last.
        parts: the levels of each part, the whole one first.
        check, antialiased: as in `formats.write`, for all levels; errors are the same as there.
    """
    ladders = [[storable(level, TITLE) for level in part] for part in parts]
    names: list[str] = []
    nodes: list[dict[str, Any]] = []
    with locked(path.parent, option=None, name=LOCK), _cleaned_up(path):
        for number, ladder in enumerate(ladders):
            node: dict[str, Any] = {"bound": _bound(ladder), "lods": {}}
            for level, arrays in enumerate(ladder):
                count = len(arrays["means"])
                node["lods"][str(level)] = {"file": len(names), "offset": 0, "count": count}
                files = sog.files_of(arrays, check, antialiased=antialiased)
                names.append(_write_sog(path.parent, f"{level}_{number}", files))
            nodes.append(node)
        sizes = [[len(arrays["means"]) for arrays in ladder] for ladder in ladders]
        levels = range(max(map(len, ladders)))
        counts = [sum(each[k] for each in sizes if k < len(each)) for k in levels]
        write_json(path, _record(counts, names, nodes))
    return counts[0]


def _write_sog(root: Path, name: str, files: Mapping[str, bytes]) -> str:
    """Write the files of a SOG; return the path of its `meta.json`, relative to `root`."""
    digest = hashlib.sha256()
    for data in files.values():
        digest.update(hashlib.sha256(data).digest())
    folder = own_folder(root, f"{name}-{digest.hexdigest()[:DIGITS]}")
    for file_name, data in files.items():
        write_bytes(folder / file_name, data)
    return f"{folder.name}/{sog.META}"


def _record(counts: list[int], names: list[str], nodes: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the content of `lod-meta.json`: Gaussians of each level, names of files, parts."""
    low = np.min([node["bound"]["min"] for node in nodes], axis=0).tolist()
    high = np.max([node["bound"]["max"] for node in nodes], axis=0).tolist()
    return {
        "version": 1,
        "asset": {"generator": sog.GENERATOR},
        "count": sum(counts),
        "counts": counts,
        "lodLevels": len(counts),
        "filenames": names,
        "tree": {"bound": {"min": low, "max": high}, "children": nodes},
    }


@contextmanager
def _cleaned_up(path: Path) -> Iterator[None]:
    """Delete folders of ours that no file called like `path` names after the block.

    They belong to the model that `path` had before, or were left by killed engines. If a file
    called like `path` is damaged, all folders stay.
    """
    try:
        yield
    finally:
        named = _named(matching(path.parent, f"*{NAME}"))
        for folder in matching(path.parent, "*_*/"):
            if FOLDER.fullmatch(folder.name) and not is_link(folder):
                remove_leftovers(folder)
                if named is not None and folder.name not in named:
                    _remove(folder)


def _named(files: Iterable[Path]) -> set[str] | None:
    """Return the folders that existing `lod-meta.json` files name; None if a file is damaged."""
    found: set[str] = set()
    for path in files:
        if not os.path.lexists(path):
            continue
        try:
            names = read_json(path)["filenames"]
            found.update(PurePosixPath(str(name)).parts[0] for name in names)
        except (RunFolderError, LookupError, TypeError):
            return None
    return found


def _remove(folder: Path) -> None:
    """Delete a SOG of ours; files of other programs stay, and so do their folders."""
    with suppress(OSError, ValueError):  # a damaged `meta.json` may hold any text
        for name in _files_of_ours(read_record(folder / sog.META)):
            (folder / name).unlink(missing_ok=True)
        folder.rmdir()  # also an empty one, of an engine that was killed at its first file


def _files_of_ours(meta: dict[str, Any]) -> tuple[str, ...]:
    """Return the files that a SOG's `meta.json` names, and it last; none for other programs' SOGs.

    If an engine is killed while it deletes them, `meta.json` still lists the rest for the next one.
    """
    if meta.get("asset") != {"generator": sog.GENERATOR}:
        return ()
    parts = [part.get("files") for part in meta.values() if isinstance(part, dict)]
    names = [name for files in parts if isinstance(files, list) for name in map(str, files)]
    return (*(name for name in names if Path(name).name == name), sog.META)


def _bound(ladder: Sequence[Arrays]) -> dict[str, list[float]]:
    """Return the box around a part's Gaussians of all levels."""
    means = np.concatenate([arrays["means"] for arrays in ladder]).astype(np.float64)
    sizes = np.concatenate([np.exp(arrays["log_scales"]).max(axis=1) for arrays in ladder])
    reach = np.minimum(sizes, np.quantile(sizes, 0.99))[:, None]  # a few reach far beyond the part
    return {
        "min": (means - reach).min(axis=0).tolist(),
        "max": (means + reach).max(axis=0).tolist(),
    }
