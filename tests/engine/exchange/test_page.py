"""Web pages: what they hold, and what a browser shows of them."""

from __future__ import annotations

import base64
import gzip
import json
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roigs_engine.cli import main
from roigs_engine.errors import EngineError
from roigs_engine.exchange import formats, page
from roigs_engine.exchange.page_views import FIELD, Ball, overview, viewpoint
from roigs_engine.formats.splat_ply import write_ply
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import Camera
from roigs_engine.rasterize.view import render_view
from tests import chromium
from tests.chromium import browser
from tests.engine.rasterize.test_placed import cloud

pytest.importorskip("gsply")
NASTY = "</script><img src=x onerror=\"document.title='broken'\">{{viewer}}"
BOX = page.Extras(title="Vase", places=[("vase", Ball(centre=np.array([0.2, 0, 0]), radius=0.5))])


def arrays(count: int = 300, seed: int = 0) -> dict[str, np.ndarray]:
    values = cloud(count, seed).arrays()
    return {**values, "sh": values["sh"][:, : page.BANDS]}


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
    shown.run("ready.then(() => 1)")
    return shown


def ours(values: dict[str, np.ndarray], shown: chromium.Page) -> np.ndarray:
    """Our renderer's picture from the page's camera."""
    width, height = shown.run("[innerWidth, innerHeight]")
    eye, back = shown.run(
        "ready.then(v => { v.camera.updateMatrixWorld();"
        " return [v.camera.position.toArray(), v.camera.matrixWorld.elements.slice(0, 12)]; })"
    )
    axes = np.array(back).reshape(3, 4)[:, :3]  # right, up, backwards
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = axes * np.array([[1], [-1], [-1]])
    world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ np.array(eye)
    focal = height / 2 / np.tan(np.radians(FIELD / 2))
    camera = Camera(width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)
    view = render_view(Gaussians.from_arrays(values), camera, world_to_camera)
    return np.asarray(view.image)


def bare(shown: chromium.Page) -> np.ndarray:
    """What is seen without texts and buttons, 0 to 1."""
    shown.run(
        "document.querySelectorAll('header, nav, #models, #message')"
        ".forEach(e => { e.style.visibility = 'hidden'; })"
    )
    time.sleep(0.5)
    return shown.picture() / 255.0


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.square(a - b).mean() + 1e-12))


def press(shown: chromium.Page, text: str) -> None:
    shown.run(
        "[...document.querySelectorAll('button')]"
        f".find(b => b.textContent === {json.dumps(text)}).click()"
    )


@browser
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_a_browser_shows_what_we_render(degree: int, tmp_path: Path) -> None:
    values = arrays()
    values["sh"] = values["sh"][:, : (degree + 1) ** 2]
    formats.write(tmp_path / "a.html", values)
    with opened(tmp_path / "a.html") as shown:
        picture = bare(shown)
        expected = ours(values, shown)
        assert expected.std() > 0.05
        assert psnr(picture, expected) > 30
        assert not shown.problems


@browser
def test_large_gaussians_reach_in_from_beside_the_picture(tmp_path: Path) -> None:
    values = arrays(300)
    angles = np.arange(16) * np.pi / 8
    ring = 2.6 * np.stack([np.cos(angles), 0 * angles, np.sin(angles)], axis=1)
    values["means"][:16] = ring
    values["log_scales"][:16] = np.log(0.5)
    values["logit_opacities"][:16] = 1.0
    formats.write(tmp_path / "a.html", values)
    with opened(tmp_path / "a.html") as shown:
        picture = bare(shown)
        assert psnr(picture, ours(values, shown)) > 33


@browser
def test_nothing_is_asked_of_the_network(tmp_path: Path) -> None:
    formats.write(tmp_path / "a.html", arrays())
    with opened(tmp_path / "a.html") as shown:
        assert all(url.startswith(("file:", "blob:")) for url in shown.requests)
        with pytest.raises(chromium.PageError):
            shown.run("fetch('https://example.org')")


@browser
def test_buttons_fly_and_switch(tmp_path: Path) -> None:
    before = {**arrays(seed=1)}
    extras = page.Extras(title="Vase", places=BOX.places, before=before)
    formats.write(tmp_path / "a.html", arrays(), extras=extras)
    target = "ready.then(v => v.controls.target.toArray())"
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
    eye = "ready.then(v => v.camera.position.toArray())"
    with opened(tmp_path / "a.html") as shown:
        start = np.array(shown.run(eye))
        getattr(shown, hand)((100, 120), (200, 130))
        time.sleep(0.5)
        end = np.array(shown.run(eye))
        middle = np.array(shown.run("ready.then(v => v.controls.target.toArray())"))
        assert np.linalg.norm(end - start) > 0.1
        far = [np.linalg.norm(place - middle) for place in (start, end)]
        assert far[0] == pytest.approx(far[1], rel=1e-3)


@browser
def test_names_are_text(tmp_path: Path) -> None:
    places = [(NASTY, BOX.places[0][1])]
    formats.write(tmp_path / "a.html", arrays(), extras=page.Extras(title=NASTY, places=places))
    with opened(tmp_path / "a.html") as shown:
        assert shown.run("document.title") == NASTY
        assert shown.run("document.querySelector('#places button:last-child').textContent") == NASTY
        assert shown.run("document.querySelectorAll('img').length") == 0


def test_the_page_holds_all(tmp_path: Path) -> None:
    path = tmp_path / "a.html"
    formats.write(path, arrays(), extras=page.Extras(places=[(NASTY, BOX.places[0][1])]))
    text = path.read_text()
    assert not re.search(r"<(script|link|img|iframe)\b[^>]*(src|href)=", text)
    assert "Permission is hereby granted" in text  # the licence of what is inside
    assert "<title>a</title>" in text
    found = description(path)
    assert [place["name"] for place in found["places"]] == ["Whole scene", NASTY]
    assert found["degree"] == 2
    packed = re.search('<script id="After" type="text/plain">(.*?)</script>', text)
    assert packed and gzip.decompress(base64.b64decode(packed[1]))[:4] == b"NGSP"


def test_higher_degrees_are_left_out(tmp_path: Path) -> None:
    formats.write(tmp_path / "a.html", cloud(300).arrays())
    assert description(tmp_path / "a.html")["degree"] == 2


def test_two_hundred_thousand_gaussians_are_ten_megabytes(tmp_path: Path) -> None:
    """Random numbers, which compress worse than those of a scene."""
    formats.write(tmp_path / "a.html", arrays(200_000))
    assert (tmp_path / "a.html").stat().st_size <= 10e6


def test_the_view_is_past_what_is_in_the_way() -> None:
    """A wall before the object, and another behind it as its background."""
    random = np.random.default_rng(0)
    wall = random.uniform(-3, 3, (4000, 3))
    wall[:2000, 0], wall[2000:, 2] = 2.0, -2.0
    values = {**cloud(4000).arrays(), "means": wall.astype(np.float32)}
    eye = viewpoint(values, Ball(centre=np.zeros(3), radius=0.5))
    assert eye[2] > 0.5 and eye[1] > 0


def test_convert_gives_places_and_the_model_before(tmp_path: Path) -> None:
    values = arrays()
    write_ply(tmp_path / "after.ply", values)
    write_ply(tmp_path / "before.ply", arrays(100, seed=1))
    rois = {"rois": [{"name": "vase", "min": [-1, 0, 0], "max": [1, 2, 4]}]}
    (tmp_path / "rois.json").write_text(json.dumps(rois))
    out = tmp_path / "vase.html"
    options = ["--before", str(tmp_path / "before.ply"), "--fly-to", str(tmp_path / "rois.json")]
    command = ["convert", str(tmp_path / "after.ply"), str(out), "--title", "A vase", *options]
    assert main(command) == 0
    found = description(out)
    assert found["models"] == ["Before", "After"]
    assert found["places"][1]["target"] == pytest.approx([0, -1, -2])  # y up
    assert "400 Gaussians" in out.read_text()  # nothing is cropped
    assert "<h1>A vase</h1>" in out.read_text()


def test_options_of_pages_are_for_pages(tmp_path: Path, capsys: Any) -> None:
    write_ply(tmp_path / "a.ply", arrays())
    command = ["convert", str(tmp_path / "a.ply"), str(tmp_path / "b.spz"), "--title", "A"]
    assert main(command) != 0
    assert "--title is for web pages alone." in capsys.readouterr().err


def test_a_missing_viewer_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "PARTS", tmp_path)
    with pytest.raises(EngineError, match="A part of web pages is missing"):
        formats.write(tmp_path / "a.html", arrays())
    assert not (tmp_path / "a.html").exists()
