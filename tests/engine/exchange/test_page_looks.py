"""Web pages: what a browser shows of them."""

from __future__ import annotations

import io
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from roigs_engine.exchange import formats, page
from roigs_engine.formats.targets import target_with
from roigs_engine.rasterize.instances import NOTHING, surface_depth
from tests import chromium
from tests.chromium import browser
from tests.engine.page_cases import (
    BOX,
    arrays,
    bare,
    camera_of,
    fine,
    opened,
    ours,
    press,
    psnr,
)

pytest.importorskip("gsply")


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
@pytest.mark.parametrize(("antialiased", "least"), [(False, 42), (True, 45)])
def test_fine_gaussians_are_drawn_as_they_were_trained(
    antialiased: bool, least: float, tmp_path: Path
) -> None:
    """With ellipses that reach as far as without, an anti-aliased model has 42 dB."""
    values = fine()
    formats.write(tmp_path / "a.html", values, target=target_with(antialiased=antialiased))
    with opened(tmp_path / "a.html") as shown:
        picture = bare(shown)
        assert psnr(picture, ours(values, shown, antialiased=antialiased)) > least
        assert psnr(picture, ours(values, shown, antialiased=not antialiased)) < 25
        assert not shown.problems


@browser
@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("photo_focal", [150.0, 1500.0])
def test_photos_of_another_size_have_another_blur(
    photo_focal: float, antialiased: bool, tmp_path: Path
) -> None:
    values = fine()
    extras = page.Extras(photo_focal=photo_focal)
    target = target_with(antialiased=antialiased)
    formats.write(tmp_path / "a.html", values, target=target, extras=extras)
    with opened(tmp_path / "a.html") as shown:
        picture = bare(shown)
        known = ours(values, shown, antialiased=antialiased, photo_focal=photo_focal)
        assert psnr(picture, known) > 43
        assert psnr(picture, ours(values, shown, antialiased=antialiased)) < 42
        assert not shown.problems


@browser
def test_the_model_before_may_be_drawn_otherwise(tmp_path: Path) -> None:
    before, after = fine(seed=1), fine()
    extras = page.Extras(before=before, before_antialiased=True)
    formats.write(tmp_path / "a.html", after, extras=extras)
    with opened(tmp_path / "a.html") as shown:
        assert psnr(bare(shown), ours(after, shown)) > 40
        press(shown, "Before")
        assert psnr(bare(shown), ours(before, shown, antialiased=True)) > 40
        press(shown, "After")
        assert psnr(bare(shown), ours(after, shown)) > 40


@browser
def test_a_mesh_is_shown_in_the_place_of_the_gaussians(tmp_path: Path) -> None:
    """A red wall, whose left half is hidden by a green one before it."""
    wall = np.array([[-0.4, -0.3, 0], [0.4, -0.3, 0], [0.4, 0.3, 0], [-0.4, 0.3, 0]])
    near = wall * (0.5, 1, 1) + (-0.2, 0, 0.1)
    picture = np.zeros((64, 64, 3), np.uint8)
    picture[:32, :, 0] = picture[32:, :, 1] = 255  # red above green
    jpeg = io.BytesIO()
    Image.fromarray(picture).save(jpeg, "JPEG", quality=95)
    quads = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    mesh = page.PageMesh(
        vertices=np.concatenate([wall, near]),
        faces=quads,
        uv=np.repeat([[0.5, 0.2], [0.5, 0.8]], 4, axis=0),
        picture=jpeg.getvalue(),
    )
    values = arrays()
    formats.write(tmp_path / "a.html", values, extras=page.Extras(meshes=[mesh]))
    with opened(tmp_path / "a.html") as shown:
        whole = bare(shown)
        assert psnr(whole, ours(values, shown)) > 36
        press(shown, "Mesh")
        time.sleep(1)
        picture, depths = bare(shown), []
        for part in (quads[:2], quads[2:]):
            triangles = torch.from_numpy(mesh.vertices[part].astype(np.float32))
            depths.append(surface_depth(triangles, *camera_of(shown)).numpy())
        red, green = (picture[..., k] > 0.6 for k in (0, 1))
        assert (green != ((depths[1] < NOTHING) & (depths[1] <= depths[0]))).mean() < 0.01
        assert (red != ((depths[0] < NOTHING) & (depths[0] < depths[1]))).mean() < 0.01
        assert red.sum() > 100 and green.sum() > 100
        press(shown, "Gaussians")
        assert psnr(bare(shown), whole) > 50
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
      let left = 600; // the worker sorts beside the frames, and answers when it can
      const step = () => {
        renderer.share = 1 / 16; // a fast machine would soon draw all
        orbit.turn(0.02, 0);
        renderer.move();
        if (left-- > 0 && (left > 590 || renderer.model.drawn >= 30000))
          requestAnimationFrame(step);
        else done([renderer.frames.length, renderer.model.drawn, renderer.size[0]]);
      };
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
def test_what_reaches_behind_the_camera_is_not_smeared(tmp_path: Path) -> None:
    """A ball about the middle is drawn from outside, and gone at twice its standard deviation."""
    values = arrays(300)
    values["means"][0], values["log_scales"][0] = 0.0, np.log(0.4)
    values["logit_opacities"][0] = 1.0
    rest = {name: column[1:] for name, column in values.items()}
    formats.write(tmp_path / "a.html", values)
    with opened(tmp_path / "a.html") as shown:
        for distance, alike in ((0.9, values), (0.7, rest)):
            shown.run(
                "ready.then(({ orbit, renderer }) => {"
                f" orbit.look([0, 0, {distance}], [0, 0, 0]); renderer.move(); }})"
            )
            picture = bare(shown)
            assert psnr(picture, ours(alike, shown)) > 36


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
