"""PlayCanvas's Streamed SOG: a model in levels of detail, of which a viewer loads what it needs.

`lod-meta.json` lists parts with their bounds, and for each level of a part the folder of a SOG.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..formats.files import atomic_write, own_folder, write_json
from . import sog
from .arrays import Arrays, Check, nothing
from .formats import storable

NAME = "lod-meta.json"
TITLE = "Streamed SOG"


def write(
    path: Path,
    parts: Sequence[Sequence[Arrays]],
    check: Check = nothing,
    *,
    antialiased: bool = False,
) -> int:
    """Write a model into the folder of `path`; returns the number of Gaussians of the whole one.

    Args:
        path: of the `lod-meta.json`, written last.
        parts: for each part its levels, the whole one first.
        check: called between the parts of the work.
        antialiased: whether the Gaussians, of all levels, are drawn with anti-aliasing.

    Raises:
        ConfigError: the format cannot hold this model.
        EngineError: a package is missing, or a file cannot be written.
    """
    ladders = [[storable(level, TITLE) for level in part] for part in parts]
    levels = max(map(len, ladders))
    names: list[str] = []
    nodes: list[dict[str, Any]] = []
    for number, ladder in enumerate(ladders):
        node: dict[str, Any] = {"bound": _bound(ladder), "lods": {}}
        for level, arrays in enumerate(ladder):
            count = len(arrays["means"])
            node["lods"][str(level)] = {"file": len(names), "offset": 0, "count": count}
            folder = own_folder(path.parent, f"{level}_{number}")
            names.append(f"{folder.name}/meta.json")
            for name, data in sog.files_of(arrays, check, antialiased=antialiased).items():
                with atomic_write(folder / name) as file:
                    file.write(data)
        nodes.append(node)
    sizes = [[len(arrays["means"]) for arrays in ladder] for ladder in ladders]
    counts = [sum(each[k] for each in sizes if k < len(each)) for k in range(levels)]
    low, high = (
        pick([node["bound"][end] for node in nodes], axis=0).tolist()
        for pick, end in ((np.min, "min"), (np.max, "max"))
    )
    write_json(
        path,
        {
            "version": 1,
            "asset": {"generator": "ROI-GS"},
            "count": sum(counts),
            "counts": counts,
            "lodLevels": levels,
            "filenames": names,
            "tree": {"bound": {"min": low, "max": high}, "children": nodes},
        },
    )
    return counts[0]


def _bound(ladder: Sequence[Arrays]) -> dict[str, list[float]]:
    """The box around a part's Gaussians, in all levels."""
    means = np.concatenate([arrays["means"] for arrays in ladder]).astype(np.float64)
    sizes = np.concatenate([np.exp(arrays["log_scales"]).max(axis=1) for arrays in ladder])
    reach = np.minimum(sizes, np.quantile(sizes, 0.99))[:, None]  # a few reach far beyond the part
    return {
        "min": (means - reach).min(axis=0).tolist(),
        "max": (means + reach).max(axis=0).tolist(),
    }
