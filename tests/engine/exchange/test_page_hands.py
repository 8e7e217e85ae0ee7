"""Web pages: buttons, mouse, fingers and keys."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.exchange import formats, page
from roigs_engine.exchange.page import overview
from tests import chromium
from tests.chromium import browser
from tests.engine.page_cases import (
    BOX,
    arrays,
    bare,
    opened,
    ours,
    press,
    psnr,
)

pytest.importorskip("gsply")


@browser
def test_buttons_fly_and_switch(tmp_path: Path) -> None:
    before = {**arrays(seed=1)}
    extras = page.Extras(title="Vase", places=BOX.places, before=before)
    formats.write(tmp_path / "a.html", arrays(), extras=extras)
    target = "ready.then(v => v.orbit.target)"
    with opened(tmp_path / "a.html") as shown:
        assert shown.run(target) == pytest.approx([0.2, 0, 0], abs=1e-6)  # starts at the box
        press(shown, "Whole scene")
        time.sleep(1.5)
        assert shown.run(target) == pytest.approx(overview(arrays()).centre, abs=1e-3)
        press(shown, "Before")
        assert psnr(bare(shown), ours(before, shown)) > 30
        press(shown, "After")
        assert psnr(bare(shown), ours(arrays(), shown)) > 30


@browser
@pytest.mark.parametrize("hand", ["drag", "swipe"])
def test_mouse_and_finger_turn_the_model(hand: str, tmp_path: Path) -> None:
    formats.write(tmp_path / "a.html", arrays())
    with opened(tmp_path / "a.html") as shown:
        start, middle = view(shown)
        getattr(shown, hand)((100, 120), (200, 130))
        end, there = view(shown)
        assert there.tolist() == middle.tolist()
        assert np.linalg.norm(end - start) > 0.1
        far = [np.linalg.norm(place - middle) for place in (start, end)]
        assert far[0] == pytest.approx(far[1], rel=1e-3)


def view(shown: chromium.Page) -> tuple[np.ndarray, np.ndarray]:
    """Where the camera is, and what it looks at."""
    eye, target = shown.run("ready.then(v => [v.orbit.position, v.orbit.target])")
    return np.array(eye), np.array(target)


def touch(shown: chromium.Page, kind: str, *points: tuple[float, float]) -> None:
    touched = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(points)]
    shown.call("Input.dispatchTouchEvent", type=kind, touchPoints=touched)


@browser
def test_fingers_and_wheel_zoom_and_move(tmp_path: Path) -> None:
    formats.write(tmp_path / "a.html", arrays())
    with opened(tmp_path / "a.html") as shown:
        start, middle = view(shown)
        wheel = {"type": "mouseWheel", "x": 100, "y": 100, "deltaX": 0, "deltaY": 300}
        shown.call("Input.dispatchMouseEvent", **wheel)
        shown.run("new Promise(requestAnimationFrame)")
        eye, _ = view(shown)
        assert np.linalg.norm(eye - middle) > 1.2 * np.linalg.norm(start - middle)
        shown.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
        touch(shown, "touchStart", (140, 120), (180, 120))
        touch(shown, "touchMove", (100, 120), (220, 120))
        touch(shown, "touchMove", (100, 160), (220, 160))
        touch(shown, "touchEnd")
        pinched, moved = view(shown)
        assert np.linalg.norm(pinched - moved) < 0.7 * np.linalg.norm(eye - middle)
        assert moved[1] > middle[1]


@browser
def test_zooming_ends_while_the_model_is_in_sight(tmp_path: Path) -> None:
    formats.write(tmp_path / "a.html", arrays())
    with opened(tmp_path / "a.html") as shown:
        start, middle = view(shown)
        far = []
        for turn in (300, -300):
            wheel = {"type": "mouseWheel", "x": 100, "y": 100, "deltaX": 0, "deltaY": turn}
            for _ in range(30):
                shown.call("Input.dispatchMouseEvent", **wheel)
            shown.run("new Promise(requestAnimationFrame)")
            far.append(np.linalg.norm(view(shown)[0] - middle))
        begin = np.linalg.norm(start - middle)
        assert far[0] <= 6.001 * begin and far[1] >= 0.999 * begin / 6


@browser
def test_keys_turn_move_and_zoom(tmp_path: Path) -> None:
    formats.write(tmp_path / "a.html", arrays())
    with opened(tmp_path / "a.html") as shown:
        start, middle = view(shown)
        for key, modifiers in (("ArrowLeft", 0), ("ArrowUp", 8), ("+", 0)):
            shown.call("Input.dispatchKeyEvent", type="keyDown", key=key, modifiers=modifiers)
        eye, target = view(shown)
        assert target[1] > middle[1]
        assert np.linalg.norm(eye - target) < np.linalg.norm(start - middle)
