"""A web page that shows Gaussians: one file, without network, with the viewer inside.

The Gaussians are SPZ (version 3) as base64, which a browser unpacks without a library. The viewer
in `page_parts/` draws them with WebGL 2 by the rules of our rasterizer.
"""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ConfigError, EngineError
from ..formats.drawable import usable
from ..formats.files import write_text
from ..formats.text import printable
from ..model.local_frame import LocalFrame
from ..model.scene import Float64
from ..rasterize.inputs import BLUR, FRUSTUM_MARGIN, NEAR
from ..rasterize.limits import PICTURE_LIMITS
from . import spz
from .arrays import Arrays
from .libraries import scratch
from .page_views import FIELD, Ball, overview, photographed, viewpoint

PARTS = Path(__file__).parent / "page_parts"
SCRIPTS = ("shaders.js", "renderer.js", "camera.js", "page.js")
BEFORE, AFTER = "Before", "After"
WHOLE = "Whole scene"


@dataclass(frozen=True, kw_only=True)
class Extras:
    """What a page shows besides the model; places and poses are in the model's frame."""

    title: str = ""  # empty: the file's name
    places: Sequence[tuple[str, Ball]] = ()  # to look at, one button each
    before: Arrays | None = None  # a second model to switch to
    before_antialiased: bool = False
    poses: Float64 | None = None
    """(N, 4, 4) world_to_camera of the photos; places are first seen from where one was taken."""


def write(
    path: Path, arrays: Arrays, extras: Extras | None = None, *, antialiased: bool = False
) -> int:
    """See `FileFormat`. ConfigError: also if `before` has no Gaussians."""
    extras = extras or Extras()
    models = {AFTER: arrays}
    if extras.before is not None:
        models = {BEFORE: usable(extras.before), AFTER: arrays}
        if not len(models[BEFORE]["means"]):
            raise ConfigError("The model before has no Gaussians.", "Give another --before.")
    drawn = {BEFORE: extras.before_antialiased, AFTER: antialiased}
    embedded = {name: _embedded(name, model, drawn[name]) for name, model in models.items()}
    counts = {name: count for name, (_, count) in embedded.items()}
    values = {
        "title": html.escape(printable(extras.title or path.stem)),
        "licence": _part("LICENSE.txt"),
        "style": _part("page.css"),
        "count": f"{sum(counts.values()):,}",
        # No HTML can end it.
        "page": json.dumps(_description(arrays, counts, extras)).replace("<", "\\u003c"),
        "models": "\n".join(text for text, _ in embedded.values()),
        "worker": _part("worker.js"),
        "script": "\n".join(_part(name).replace('"use strict";\n', "") for name in SCRIPTS),
    }
    text = re.sub(r"\{\{(\w+)\}\}", lambda found: values[found[1]], _part("page.html"))
    write_text(path, text)
    return counts[AFTER]


def _description(shown: Arrays, counts: dict[str, int], extras: Extras) -> dict[str, Any]:
    whole = None if extras.poses is None else photographed(extras.poses)
    whole = whole or overview(shown)
    balls = [whole, *(ball for _, ball in extras.places)]
    views = [viewpoint(shown, ball, extras.poses) for ball in balls]
    names = [WHOLE, *(printable(name) for name, _ in extras.places)]
    places = [
        {"name": name, "target": ball.centre.tolist(), "position": position.tolist()}
        for name, ball, position in zip(names, balls, views, strict=True)
    ]
    scale = LocalFrame.of_centres(shown["means"].astype(np.float64)).scale
    return {
        "models": list(counts),
        "counts": counts,
        "places": places,
        "field": FIELD,
        "rules": {
            "near": NEAR / scale,
            "blur": BLUR,
            "slope": PICTURE_LIMITS.max_slope,
            "sigmas": PICTURE_LIMITS.min_sigmas,
            "margin": FRUSTUM_MARGIN,
        },
    }


def _embedded(name: str, arrays: Arrays, antialiased: bool) -> tuple[str, int]:
    """A script element with the model, and how many Gaussians it has.

    The viewer knows from the SPZ's header whether to draw with anti-aliasing.
    """
    with scratch("A web page") as folder:
        made = folder / "model.spz"
        # A page is to be small.
        count = spz.write(made, arrays, step=spz.STEPS[-1], antialiased=antialiased)
        text = base64.b64encode(made.read_bytes()).decode()
    return f'<script id="{name}" type="text/plain">{text}</script>', count


def _part(name: str) -> str:
    """A file of the page; EngineError if it is missing."""
    try:
        return (PARTS / name).read_text(encoding="utf-8")
    except OSError as error:
        raise EngineError(
            f"A part of web pages is missing: {PARTS / name}.", "Install the engine again."
        ) from error
