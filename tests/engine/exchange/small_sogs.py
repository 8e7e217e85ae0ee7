"""Streamed SOGs without pictures, written at once; a separate process can import this."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from roigs_engine.exchange import sog, streamed_sog
from roigs_engine.exchange.arrays import Arrays


def small(model: Arrays, *_: object, **__: object) -> dict[str, bytes]:
    """In place of `sog.files_of`, which needs packages and time."""
    count = len(model["means"])
    meta = {"asset": {"generator": "ROI-GS"}, "count": count, "sh0": {"files": ["sh0.webp"]}}
    return {"meta.json": json.dumps(meta).encode(), "sh0.webp": b"%d" % count}


def written(
    path: Path, parts: Sequence[Sequence[Arrays]], files_of: Callable[..., Any] = small
) -> None:
    """Write a model with `files_of` in place of `sog.files_of`."""
    before, sog.files_of = sog.files_of, files_of
    try:
        streamed_sog.write(path, parts)
    finally:
        sog.files_of = before
