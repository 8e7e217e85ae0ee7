"""Web pages for tests: what is shown, and a browser that shows it."""

from __future__ import annotations

import json
import re
import time
from pathlib import Path
from typing import Any

import numpy as np

from roigs_engine.exchange import page
from roigs_engine.exchange.page import FIELD, Ball
from roigs_engine.formats.targets import target_with
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import Camera
from roigs_engine.rasterize.view import render_view
from tests import chromium
from tests.engine.clouds import cloud

NASTY = "</script><img src=x onerror=\"document.title='broken'\">{{viewer}}"
BOX = page.Extras(title="Vase", places=[("vase", Ball(centre=np.array([0.2, 0, 0]), radius=0.5))])


def arrays(count: int = 300, seed: int = 0) -> dict[str, np.ndarray]:
    return cloud(count, seed).arrays()


def fine(count: int = 3000, seed: int = 0) -> dict[str, np.ndarray]:
    """Gaussians from far below a pixel's size to some pixels."""
    values = arrays(count, seed)
    random = np.random.default_rng(seed)
    values["log_scales"] = random.uniform(-9, -3, (count, 3)).astype(np.float32)
    return values


def description(path: Path) -> Any:
    found = re.search('<script id="page"[^>]*>(.*?)</script>', path.read_text())
    assert found
    return json.loads(found[1])


def opened(path: Path, **size: int) -> chromium.Page:
    """The page, once it shows something."""
    shown = chromium.Page(path, **size)
    end = time.monotonic() + 60
    while not shown.run("window.ready !== undefined") and time.monotonic() < end:
        time.sleep(0.1)
    still(shown)
    return shown


def still(shown: chromium.Page) -> None:
    """Wait until the whole picture of the view is shown."""
    end = time.monotonic() + 60
    while shown.run("document.getElementById('message').textContent") and time.monotonic() < end:
        time.sleep(0.05)
    shown.run(
        "ready.then(({ renderer: r }) => r.whole && r.whole.done ? 1 : r.settled().then(() => 1))"
    )


def camera_of(shown: chromium.Page) -> tuple[Camera, np.ndarray]:
    """The page's camera and world_to_camera (4, 4)."""
    width, height = shown.run("[innerWidth, innerHeight]")
    eye, axes = shown.run("ready.then(({ orbit }) => [orbit.position, orbit.axes()])")
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = np.array(axes) * np.array([[1], [-1], [-1]])
    world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ np.array(eye)
    focal = height / 2 / np.tan(np.radians(FIELD / 2))
    size = {"width": width, "height": height, "cx": width / 2, "cy": height / 2}
    return Camera(fx=focal, fy=focal, **size), world_to_camera


def ours(
    values: dict[str, np.ndarray],
    shown: chromium.Page,
    *,
    antialiased: bool = False,
    photo_focal: float | None = None,
) -> np.ndarray:
    """Our renderer's picture from the page's camera."""
    target = target_with(antialiased=antialiased)
    model = Gaussians.from_arrays(values, target=target, photo_focal=photo_focal)
    return np.asarray(render_view(model, *camera_of(shown)).image)


def bare(shown: chromium.Page) -> np.ndarray:
    """The picture without texts and buttons, 0 to 1."""
    shown.run(
        "document.querySelectorAll('header, nav, #models, #message')"
        ".forEach(e => { e.style.visibility = 'hidden'; })"
    )
    still(shown)
    return shown.picture() / 255.0


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.square(a - b).mean() + 1e-12))


def press(shown: chromium.Page, text: str) -> None:
    shown.run(
        "[...document.querySelectorAll('button')]"
        f".find(b => b.textContent === {json.dumps(text)}).click()"
    )
