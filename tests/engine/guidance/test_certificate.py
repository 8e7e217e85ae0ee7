"""A certificate has the numbers of the data: size, pixels, gaps, scores, hashes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roigs_engine import Certify, certify
from roigs_engine.errors import EngineError
from roigs_engine.formats.files import sha256
from roigs_engine.guidance.certificate import NAMED, Certificate, certificate, certificate_page
from roigs_engine.guidance.known import KnownBox, known_box
from roigs_engine.guidance.words import Units
from tests.engine.guidance.ball import BOX, CAMERA, RADIUS, VIEWS, ball_scene
from tests.engine.synthetic_colmap import write_project

HALF = tuple(np.pi * np.arange(13) / 12 - np.pi / 2)
INNER = replace(BOX, half_extents=np.array([0.42, 0.42, 0.39]))
"""Without the table."""
METRES = 0.5


def of(known: KnownBox) -> Certificate:
    return certificate(known, Units(scale=METRES), {"object_psnr": 27.126}, {"Software": "x <1>"})


@pytest.fixture(scope="module")
def around() -> KnownBox:
    return known_box(ball_scene(), INNER, look=False)


@pytest.fixture(scope="module")
def one_side() -> KnownBox:
    return known_box(ball_scene(HALF), INNER, look=False)


def test_the_size_is_the_balls(around: KnownBox) -> None:
    width, depth, height = of(around).size
    assert width == pytest.approx(2 * RADIUS, rel=0.03)
    assert depth == pytest.approx(2 * RADIUS, rel=0.03)
    assert height < 2 * RADIUS  # nobody sees it from below


def test_a_pixel_is_as_large_as_geometry_says(around: KnownBox) -> None:
    made, found = of(around), around.map
    best = []
    for place, normal, seen in zip(
        found.patches.places, found.patches.normals, found.seen, strict=True
    ):
        sizes = []
        for image in np.array(found.images, dtype=object)[seen]:
            way = image.centre - place
            cosine = way @ normal / np.linalg.norm(way)
            if cosine > 0:
                sizes.append(image.local(place[None])[0, 2] / CAMERA.fx / np.sqrt(cosine))
        best += [min(sizes)] if sizes else []
    assert made.pixel_median == pytest.approx(np.median(best))
    assert made.pixel_largest == pytest.approx(max(best))
    assert f"{1000 * METRES * made.pixel_median:.2g} mm per pixel" in certificate_page(made)


def test_a_removed_side_is_found(around: KnownBox, one_side: KnownBox) -> None:
    whole, half = of(around), of(one_side)
    assert half.unseen > whole.unseen + 0.1
    assert half.covered < 0.75 * whole.covered
    assert half.known < whole.known
    known = np.array([[x, y, np.nan if k is None else k] for x, y, k in half.directions])
    left, right = known[known[:, 0] < -0.2], known[known[:, 0] > 0.2]
    assert np.nanmean(left[:, 2]) < 0.5 * np.nanmean(right[:, 2])
    worst = int(np.nanargmin(known[:, 2]))
    assert known[worst, 0] < 0 and f"({known[worst, 2]:.0%} known)" in half.worst


def test_the_page_is_of_the_numbers_and_names_are_text(around: KnownBox) -> None:
    made = of(around)
    page = certificate_page(made)
    assert "27.13 dB" in page and f"{made.known:.0%}" in page and f"{made.covered:.0%}" in page
    assert "x &lt;1&gt;" in page and "<1>" not in page
    assert f"<td>{len(made.photos)}</td>" in page and len(made.photos) == VIEWS
    assert made.photos_digest in page and "default-src 'none'" in page
    many = replace(made, photos=tuple(f"p{k}" for k in range(NAMED + 3)))
    assert "and 3 more" in certificate_page(many)


def test_other_photos_have_another_digest(around: KnownBox, one_side: KnownBox) -> None:
    assert of(around).photos_digest != of(one_side).photos_digest
    images = around.map.images
    changed = (replace(images[0], file_digest="other"), *images[1:])
    other = replace(around, map=replace(around.map, images=changed))
    assert of(other).photos_digest != of(around).photos_digest


def test_a_run_gives_scores_and_hashes_and_gets_a_section(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(300, 3))
    ball *= 0.4 / np.linalg.norm(ball, axis=1)[:, None]
    names = tuple(f"{number:02d}.png" for number in range(12))
    write_project(tmp_path / "scene", names=names, points=ball, dots=True)
    run, out = tmp_path / "run", tmp_path / "out"
    (run / "rois").mkdir(parents=True)
    (run / "result.ply").write_bytes(b"scene")
    (run / "rois" / "pot.ply").write_bytes(b"pot")
    (run / "split.json").write_text(json.dumps({"test": ["03.png"]}))
    row = {"model": "Joint", "object_psnr": 31.234, "roi_ssim": 0.9, "roi_flip": None}
    report = {"rois": [{"roi": "pot", "rows": [{"object_psnr": 20.0}, row]}]}
    (run / "report.json").write_text(json.dumps(report))
    (run / "report.md").write_text("# Evaluation\n")
    (run / "report.html").write_text("<h1>Evaluation</h1>\n<script></script>\n")
    request = Certify(
        scene=tmp_path / "scene", roi=("pot=-.5,-.5,-.5,.5,.5,.5",), run_dir=run, out=out
    )
    made = certify(request).certificates[0]
    assert made.scores == {"object_psnr": 31.234, "roi_ssim": 0.9}
    assert made.facts["SHA-256 of the scene's result"] == sha256(run / "result.ply")
    assert made.facts["SHA-256 of the object's Gaussians"] == sha256(run / "rois" / "pot.ply")
    assert "03.png" not in made.photos and len(made.photos) == 11
    record = json.loads((out / "certificates.json").read_text())["certificates"][0]
    assert record["pixel_median"] == made.pixel_median and record["metres"] is None
    photo = tmp_path / "scene" / "images" / made.photos[0]
    photo.write_bytes(photo.read_bytes() + b" ")  # pixels as before, another file
    again = certify(request).certificates[0]  # the section is replaced
    assert again.photos_digest != made.photos_digest
    assert (run / "report.md").read_text().count("## Certificates") == 1
    page = (run / "report.html").read_text()
    assert page.count("<h2>Certificates</h2>") == 1
    assert page.index("Certificates") < page.index("<script>")
    with pytest.raises(EngineError, match="not the folder of a finished run"):
        certify(replace(request, run_dir=out))
