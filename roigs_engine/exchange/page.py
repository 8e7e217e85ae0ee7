"""A web page that shows Gaussians: one file with the viewer inside, which needs no network.

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
from numpy.typing import NDArray

from ..errors import ConfigError, EngineError
from ..formats.drawable import usable
from ..formats.files import write_text
from ..formats.targets import BLUR, BOX
from ..formats.text import printable
from ..model.local_frame import LocalFrame
from ..model.scene import Float64
from ..rasterize.inputs import FRUSTUM_MARGIN, NEAR
from ..rasterize.limits import PICTURE_LIMITS
from ..rasterize.view import LEAST_PIXEL
from . import spz
from .arrays import Arrays, opacities

PARTS = Path(__file__).parent / "page_parts"
SCRIPTS = ("shaders.js", "renderer.js", "mesh.js", "camera.js", "page.js")
BEFORE, AFTER, ALONE, MESH = "Before", "After", "Gaussians", "Mesh"
WHOLE = "Whole scene"
FIELD = 50.0  # degrees; the viewer's vertical field of view
MARGIN = 1.1  # around the region that is looked at
ELEVATION = 20.0  # degrees above the horizon
DIRECTIONS = 24
AIMED = 20.0  # most degrees between a photo's view direction and a region that it looks at
PHOTOS = 60  # most photos that are compared
SAMPLE = 100_000  # most Gaussians that are used to choose a viewpoint
CORE = 1.5  # radius of an overview in median distances from the middle: not all of a background


@dataclass(frozen=True, kw_only=True, eq=False)
class Ball:
    """A region to look at: everything within `radius` of `centre` (3,)."""

    centre: Float64
    radius: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PageMesh:
    """A textured mesh in the model's frame.

    Attributes:
        vertices, faces: (V, 3), (F, 3).
        uv: (V, 2) places in the picture, from its upper left corner, 0 to 1.
        picture: a JPEG.
    """

    vertices: Float64
    faces: NDArray[np.int64]
    uv: Float64
    picture: bytes


@dataclass(frozen=True, kw_only=True)
class Extras:
    """The extra content of a page; places and poses are in the model's frame."""

    title: str = ""  # empty: the file's name
    places: Sequence[tuple[str, Ball]] = ()  # regions to look at, one button each
    before: Arrays | None = None  # a second model to switch to
    before_antialiased: bool = False
    meshes: Sequence[PageMesh] = ()  # to switch to
    poses: Float64 | None = None
    """(N, 4, 4) world_to_camera of the photos; a place is first shown from the side of a photo."""
    photo_focal: float | None = None  # of `Gaussians`


def write(
    path: Path, arrays: Arrays, extras: Extras | None = None, *, antialiased: bool = False
) -> int:
    """See `FileFormat`. ConfigError also if `before` has no Gaussians."""
    extras = extras or Extras()
    models = {ALONE if extras.meshes else AFTER: arrays}
    if extras.before is not None:
        models = {BEFORE: usable(extras.before), AFTER: arrays}
        if not len(models[BEFORE]["means"]):
            raise ConfigError("The model before has no Gaussians.", "Give another --before.")
    before = {BEFORE: extras.before_antialiased}
    embedded = {
        name: _embedded(name, model, before.get(name, antialiased))
        for name, model in models.items()
    }
    counts = {name: count for name, (_, count) in embedded.items()}
    values = {
        "title": html.escape(printable(extras.title or path.stem)),
        "licence": _part("LICENSE.txt"),
        "style": _part("page.css"),
        "count": f"{sum(counts.values()):,}",
        # No HTML can end it.
        "page": json.dumps(_description(arrays, counts, extras)).replace("<", "\\u003c"),
        "models": "\n".join([*(text for text, _ in embedded.values()), *_embedded_meshes(extras)]),
        "worker": _part("worker.js"),
        "script": "\n".join(_part(name).replace('"use strict";\n', "") for name in SCRIPTS),
    }
    text = re.sub(r"\{\{(\w+)\}\}", lambda found: values[found[1]], _part("page.html"))
    write_text(path, text)
    return [*counts.values()][-1]


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
        "meshes": len(extras.meshes),
        "places": places,
        "field": FIELD,
        "rules": {
            "near": NEAR / scale,
            "blur": BLUR,
            "box": BOX,
            "magnified": 1 / LEAST_PIXEL,
            "photo_focal": extras.photo_focal or 0.0,
            "slope": PICTURE_LIMITS.max_slope,
            "sigmas": PICTURE_LIMITS.min_sigmas,
            "margin": FRUSTUM_MARGIN,
        },
    }


def _embedded(name: str, arrays: Arrays, antialiased: bool) -> tuple[str, int]:
    """Return a script element with the model, and the number of its Gaussians.

    The SPZ's header tells the viewer whether to draw with anti-aliasing.
    """
    data, count = spz.encoded(arrays, spz.STEPS[-1], antialiased=antialiased)  # a small page
    text = base64.b64encode(data).decode()
    return f'<script id="{name}" type="text/plain">{text}</script>', count


def _embedded_meshes(extras: Extras) -> list[str]:
    """Return a script element with all meshes, if there are any."""

    def text(values: NDArray[Any] | bytes, kind: str = "") -> str:
        data = values if isinstance(values, bytes) else values.astype(kind).tobytes()
        return base64.b64encode(data).decode()

    meshes = [
        {
            "places": text(mesh.vertices, "<f4"),
            "uvs": text(mesh.uv, "<f4"),
            "faces": text(mesh.faces, "<u4"),
            "picture": text(mesh.picture),
        }
        for mesh in extras.meshes
    ]
    script = f'<script id="{MESH}" type="text/plain">{json.dumps(meshes)}</script>'
    return [script] if meshes else []


def _part(name: str) -> str:
    """Return the text of a file of the page; EngineError if it is missing."""
    try:
        return (PARTS / name).read_text(encoding="utf-8")
    except OSError as error:
        raise EngineError(
            f"A part of web pages is missing: {PARTS / name}.", "Install the engine again."
        ) from error


# --- viewpoints ---


def overview(arrays: Arrays) -> Ball:
    """Return a ball around most of a model."""
    means = arrays["means"].astype(np.float64)
    middle = np.median(means, axis=0)
    radius = CORE * float(np.median(np.linalg.norm(means - middle, axis=1)))
    return Ball(centre=middle, radius=radius or 1.0)


def photographed(poses: Float64) -> Ball | None:
    """Return a ball that fills a picture from the photos' median distance; None without a middle.

    `poses` are (N, 4, 4) world_to_camera, OpenCV axes.
    """
    eyes, forwards = _eyes(poses), poses[:, 2, :3]
    across = np.eye(3) - forwards[:, :, None] * forwards[:, None, :]
    # The point nearest to the lines of sight.
    middle = np.linalg.lstsq(across.sum(axis=0), np.einsum("nij,nj->i", across, eyes), rcond=0.01)
    centre: Float64 = middle[0]
    depths = ((centre - eyes) * forwards).sum(axis=1)
    if np.median(depths) <= 0:
        return None
    distance = float(np.median(np.linalg.norm(centre - eyes, axis=1)))
    return Ball(centre=centre, radius=distance * np.sin(np.radians(FIELD / 2)) / MARGIN)


def _eyes(poses: Float64) -> Float64:
    return np.asarray(-np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3]))


def photo_directions(poses: Float64, ball: Ball) -> Float64:
    """Return (K, 3) directions from the ball to photos that look at it, at most `PHOTOS`."""
    away = _eyes(poses) - ball.centre
    lengths = np.linalg.norm(away, axis=1)
    away /= np.maximum(lengths, 1e-30)[:, None]
    aimed = -(away * poses[:, 2, :3]).sum(axis=1) > np.cos(np.radians(AIMED))
    found: Float64 = away[aimed & (lengths > ball.radius)]
    return found[:: -(-len(found) // PHOTOS)] if len(found) else found


def _ring() -> Float64:
    """Return directions from all around and a little above."""
    angles = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    rise = np.full(DIRECTIONS, np.radians(ELEVATION))
    return np.column_stack(
        (np.cos(rise) * np.sin(angles), np.sin(rise), np.cos(rise) * np.cos(angles))
    )


def viewpoint(arrays: Arrays, ball: Ball, poses: Float64 | None = None) -> Float64:
    """Return a position (3,), y up, that sees the ball with little before it and much behind it.

    Photos are taken through free space, and show the background: a side without background is
    mostly one that no photo shows. With the photos' `poses`, the position is in the direction of a
    photo that looks at the ball.
    """
    directions = _ring() if poses is None else photo_directions(poses, ball)
    if not len(directions):
        directions = _ring()
    distance = MARGIN * ball.radius / np.sin(np.radians(FIELD / 2))
    step = max(1, len(arrays["means"]) // SAMPLE)
    means = arrays["means"][::step].astype(np.float64) - ball.centre
    some = {name: values[::step] for name, values in arrays.items()}
    sizes = np.sort(np.exp(some["log_scales"].astype(np.float64)), axis=1)
    areas = opacities(some) * sizes[:, 1] * sizes[:, 2] * step
    best, least = np.zeros(3), np.inf
    for towards in directions:
        depth = distance - means @ towards  # from the camera
        across = np.linalg.norm(means - np.outer(means @ towards, towards), axis=1)
        seen = (depth > 0) & (across < ball.radius * depth / distance)
        solid = np.where(seen, areas / np.maximum(depth, 0.05 * distance) ** 2, 0.0)
        angles = np.pi * (ball.radius / distance) ** 2  # that the ball fills
        before = solid[depth < distance - ball.radius].sum() / angles
        behind = solid[depth > distance + ball.radius].sum() / angles
        cost = before - 0.5 * min(1.0, behind)
        if cost < least:
            best, least = towards, cost
    return np.asarray(ball.centre + distance * best)
