"""Web pages: what they hold, and what a browser shows of them."""

from __future__ import annotations

import base64
import gzip
import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from roigs_engine.cli import main
from roigs_engine.errors import EngineError
from roigs_engine.exchange import formats, page
from roigs_engine.exchange.axes import UP
from roigs_engine.exchange.page_views import FIELD, Ball, overview, viewpoint
from roigs_engine.formats.splat_ply import write_ply
from roigs_engine.formats.upright import levelled
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import Camera
from roigs_engine.rasterize.view import render_view
from tests import chromium
from tests.chromium import browser
from tests.engine import synthetic_colmap
from tests.engine.rasterize.test_placed import cloud
from tests.engine.synthetic_colmap import ring, write_project

pytest.importorskip("gsply")
NASTY = "</script><img src=x onerror=\"document.title='broken'\">{{viewer}}"
BOX = page.Extras(title="Vase", places=[("vase", Ball(centre=np.array([0.2, 0, 0]), radius=0.5))])


def arrays(count: int = 300, seed: int = 0) -> dict[str, np.ndarray]:
    return cloud(count, seed).arrays()


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


def ours(values: dict[str, np.ndarray], shown: chromium.Page) -> np.ndarray:
    """Our renderer's picture from the page's camera."""
    width, height = shown.run("[innerWidth, innerHeight]")
    eye, axes = shown.run("ready.then(({ orbit }) => [orbit.position, orbit.axes()])")
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = np.array(axes) * np.array([[1], [-1], [-1]])
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
    still(shown)
    return shown.picture() / 255.0


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.square(a - b).mean() + 1e-12))


def press(shown: chromium.Page, text: str) -> None:
    shown.run(
        "[...document.querySelectorAll('button')]"
        f".find(b => b.textContent === {json.dumps(text)}).click()"
    )


@browser
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_browser_shows_what_we_render(degree: int, tmp_path: Path) -> None:
    values = arrays()
    values["sh"] = values["sh"][:, : (degree + 1) ** 2]
    formats.write(tmp_path / "a.html", values)
    with opened(tmp_path / "a.html") as shown:
        picture = bare(shown)
        expected = ours(values, shown)
        assert expected.std() > 0.05
        assert psnr(picture, expected) > 36
        assert not shown.problems


@browser
def test_many_gaussians_show_soon_and_right(tmp_path: Path) -> None:
    """A viewer with an instance for each of so many showed nothing within minutes."""
    values = arrays(150_000)
    values["log_scales"] -= 2.0
    formats.write(tmp_path / "a.html", values)
    start = time.monotonic()
    with opened(tmp_path / "a.html", width=640, height=480) as shown:
        assert time.monotonic() - start < 60
        assert psnr(bare(shown), ours(values, shown)) > 30


@browser
def test_a_moving_view_is_drawn_with_less_and_then_whole(tmp_path: Path) -> None:
    values = arrays(60_000)
    formats.write(tmp_path / "a.html", values)
    turn = """ready.then(({ orbit, renderer }) => new Promise((done) => {
      let left = 30;
      const step = () => {
        orbit.turn(0.02, 0);
        renderer.move();
        if (left-- > 0) requestAnimationFrame(step);
        else done([renderer.frames.length, renderer.model.drawn, renderer.size[0]]);
      };
      renderer.share = 1 / 16;
      step();
    }))"""
    with opened(tmp_path / "a.html") as shown:
        frames, drawn, width = shown.run(turn)
        assert frames > 1
        assert drawn < 30_000 and width < 320
        assert psnr(bare(shown), ours(values, shown)) > 30


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


@browser
def test_texts_and_buttons_do_not_overlap_on_a_phone(tmp_path: Path) -> None:
    extras = page.Extras(title="A long title " * 8, places=BOX.places, before=arrays(seed=1))
    formats.write(tmp_path / "a.html", arrays(), extras=extras)
    with opened(tmp_path / "a.html", width=360, height=640) as shown:
        boxes = shown.run(
            "['h1', 'header p', '#models', '#places'].map((name) => {"
            " const box = document.querySelector(name).getBoundingClientRect();"
            " return [box.top, box.bottom]; })"
        )
        edges = [edge for box in boxes for edge in box]
        assert edges == sorted(edges)


@browser
def test_without_webgl_the_page_says_so(tmp_path: Path) -> None:
    path = tmp_path / "a.html"
    formats.write(path, arrays())
    cut = "<script>HTMLCanvasElement.prototype.getContext = () => null;</script><body>"
    path.write_text(path.read_text().replace("<body>", cut))
    with chromium.Page(path) as shown:
        end = time.monotonic() + 30
        message = "document.getElementById('message')?.textContent"
        while "WebGL 2" not in str(shown.run(message)) and time.monotonic() < end:
            time.sleep(0.1)
        assert "Open the page in another browser." in shown.run(message)


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
    packed = re.search('<script id="After" type="text/plain">(.*?)</script>', text)
    assert packed and gzip.decompress(base64.b64decode(packed[1]))[:4] == b"NGSP"


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


def embedded_means(path: Path) -> np.ndarray:
    """Positions of the page's model, along x in ascending order."""
    text = path.read_text(encoding="utf-8")
    packed = re.search('<script id="After" type="text/plain">(.*?)</script>', text)
    assert packed is not None
    model = path.with_suffix(".spz")
    model.write_bytes(base64.b64decode(packed[1]))
    means = formats.read(model)["means"].astype(np.float64)
    return means[np.lexsort(np.round(means, 4).T[::-1])]


def test_a_scene_says_what_is_up_and_where_photos_were_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "run"
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_rotvec([0.4, 0.5, 0.9]).as_matrix()
    monkeypatch.setattr(synthetic_colmap, "ring", lambda *given: ring(*given) @ turned)
    names = [f"{k}.png" for k in range(8)]
    scene = write_project(run / "colmap", names=names, arc=np.pi).folder
    values = arrays()
    values["means"] = np.random.default_rng(0).normal(0, 0.1, (300, 3)).astype(np.float32)
    write_ply(run / "result.ply", values)
    given = ["convert", str(run / "result.ply"), str(tmp_path / "a.html"), "--scene", str(scene)]
    assert main(given) == 0
    place = description(tmp_path / "a.html")["places"][0]
    away = np.array(place["position"]) - place["target"]
    assert place["target"] == pytest.approx([0, 0, 0], abs=0.01)
    assert np.linalg.norm(away) == pytest.approx(np.sqrt(17), abs=0.01)  # as far as the photos
    assert np.degrees(np.arctan2(away[1], np.hypot(away[0], away[2]))) == pytest.approx(14, abs=2)
    assert main(given[:-2]) == 0  # the run folder's own
    assert description(tmp_path / "a.html")["places"][0] == place
    assert main([*given, "--from-up", "z"]) == 2
    # A file that was turned stands where the scene has it.
    assert main(["convert", str(run / "result.ply"), str(run / "result.glb")]) == 0
    given[1:3] = [str(run / "result.glb"), str(tmp_path / "b.html")]
    assert main(given) == 0
    models = [embedded_means(tmp_path / name) for name in ("a.html", "b.html")]
    np.testing.assert_allclose(models[1], models[0], atol=1e-3)


def run_of(up: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run folder with its project, in which an axis points up."""
    before = levelled(ring(8, np.pi))[2]
    wanted = np.array(UP[up])[:, 2]
    turned = np.eye(4)
    turned[:3, :3] = Rotation.align_vectors([before], [wanted])[0].as_matrix()
    monkeypatch.setattr(synthetic_colmap, "ring", lambda *given: ring(*given) @ turned)
    run = folder / "run"
    write_project(run / "colmap", names=[f"{k}.png" for k in range(8)], arc=np.pi)
    return run


@pytest.mark.parametrize("up", UP)
def test_a_model_that_would_lie_on_its_side_is_named(
    up: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the photos of the run that made it: the projects of `reconstruct` have z up."""
    run = run_of(up, tmp_path, monkeypatch)
    (run / "rois").mkdir()
    for name in ("result.ply", "rois/vase.ply", "mine.ply"):
        write_ply(run / name, arrays())
        assert main(["convert", str(run / name), str(tmp_path / "a.glb")]) == 0
        said = capsys.readouterr().err
        warned = up != "-y" and name != "mine.ply"
        assert (f"Choose {up} as its axis that points up (--from-up={up})" in said) == warned
        assert main(["convert", str(run / name), str(tmp_path / "a.glb"), f"--from-up={up}"]) == 0
        assert "lies on its side" not in capsys.readouterr().err


def test_which_way_is_up_needs_the_poses_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not the photos, nor the points, which take long to read."""
    run = run_of("z", tmp_path, monkeypatch)
    write_ply(run / "result.ply", arrays())
    shutil.rmtree(run / "colmap" / "images")
    (points,) = run.rglob("points3D.*")
    points.write_bytes(b"?")
    command = ["convert", str(run / "result.ply"), str(tmp_path / "a.glb")]
    assert main(command) == 0
    assert "--from-up=z" in capsys.readouterr().err
    (images,) = run.rglob("images.*")
    images.write_bytes(b"?")
    assert main(command) == 0
    assert "--from-up=" not in capsys.readouterr().err


def test_a_list_of_models_says_where_photos_were_taken(tmp_path: Path, capsys: Any) -> None:
    values = arrays()
    values["means"] = np.random.default_rng(0).normal(0, 0.1, (300, 3)).astype(np.float32)
    write_ply(tmp_path / "a.ply", values)
    model = {"ply": str(tmp_path / "a.ply"), "matrix": np.eye(4).tolist()}
    # Two cameras on the x axis, 3 from the origin and looking there; z is up.
    poses = [[[0, s, 0, 0], [0, 0, -1, 0], [-s, 0, 0, 3], [0, 0, 0, 1]] for s in (1, -1)]

    def written(photos: object) -> int:
        (tmp_path / "a.json").write_text(json.dumps({"models": [model], "photos": photos}))
        out = str(tmp_path / "a.html")
        return main(["convert", str(tmp_path / "a.json"), out, "--from-up", "z"])

    assert written(poses) == 0
    place = description(tmp_path / "a.html")["places"][0]
    assert np.abs(place["position"]) == pytest.approx([3, 0, 0], abs=0.1)
    assert written([]) == 0
    assert description(tmp_path / "a.html")["places"][0] != place
    for damaged in ([[1]], 5, [[[float("nan")] * 4] * 4]):
        assert written(damaged) == 2
        assert "malformed" in capsys.readouterr().err


def test_options_of_pages_are_for_pages(tmp_path: Path, capsys: Any) -> None:
    write_ply(tmp_path / "a.ply", arrays())
    command = ["convert", str(tmp_path / "a.ply"), str(tmp_path / "b.spz"), "--title", "A"]
    assert main(command) != 0
    assert "--title is for web pages alone." in capsys.readouterr().err


def test_a_wheel_holds_the_parts_of_a_page(tmp_path: Path) -> None:
    """What `build_py` gathers is what a wheel holds, besides the kernels."""
    pytest.importorskip("setuptools")
    root = Path(page.__file__).parents[2]
    names = ("setup.py", "pyproject.toml", "README.md", "LICENSE", "MANIFEST.in")
    for name in names:
        shutil.copy(root / name, tmp_path)
    left_out = shutil.ignore_patterns("lib", "__pycache__")
    shutil.copytree(root / "roigs_engine", tmp_path / "roigs_engine", ignore=left_out)
    command = [sys.executable, "setup.py", "-q", "build_py", "--build-lib", "built"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=120, capture_output=True)
    made = tmp_path / "built" / "roigs_engine" / "exchange" / "page_parts"
    parts = sorted(path.name for path in page.PARTS.iterdir())
    assert sorted(path.name for path in made.iterdir()) == parts
    assert {*page.SCRIPTS, "worker.js", "page.html", "page.css", "LICENSE.txt"} == set(parts)


def test_a_missing_viewer_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "PARTS", tmp_path)
    with pytest.raises(EngineError, match="A part of web pages is missing"):
        formats.write(tmp_path / "a.html", arrays())
    assert not (tmp_path / "a.html").exists()


def test_a_name_that_is_no_utf8(tmp_path: Path) -> None:
    pytest.importorskip("gsply")
    path = tmp_path / os.fsdecode(b"a\xff.html")
    formats.write(path, arrays())
    assert "<title>a\\udcff</title>" in path.read_text(encoding="utf-8")
