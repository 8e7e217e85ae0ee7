"""Web pages: what they hold."""

from __future__ import annotations

import base64
import gzip
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from roigs_engine.cli import main
from roigs_engine.errors import EngineError
from roigs_engine.exchange import formats, page
from roigs_engine.formats.splat_ply import write_ply
from roigs_engine.formats.targets import target_with
from tests import chromium
from tests.chromium import browser
from tests.engine.page_cases import (
    BOX,
    NASTY,
    arrays,
    description,
    opened,
)

pytest.importorskip("gsply")


@browser
def test_nothing_is_asked_of_the_network(tmp_path: Path) -> None:
    formats.write(tmp_path / "a.html", arrays())
    with opened(tmp_path / "a.html") as shown:
        assert all(url.startswith(("file:", "blob:")) for url in shown.requests)
        with pytest.raises(chromium.PageError):
            shown.run("fetch('https://example.org')")


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
    assert unpacked(path, "After")[:4] == b"NGSP"


def unpacked(path: Path, name: str) -> bytes:
    """The SPZ of a page's model, without gzip."""
    packed = re.search(f'<script id="{name}" type="text/plain">(.*?)</script>', path.read_text())
    assert packed
    return gzip.decompress(base64.b64decode(packed[1]))


@pytest.mark.parametrize("smooth", ["before", "after"])
def test_convert_tells_of_each_model_whether_it_is_antialiased(smooth: str, tmp_path: Path) -> None:
    for name in ("before", "after"):
        write_ply(
            tmp_path / f"{name}.ply", arrays(), target=target_with(antialiased=name == smooth)
        )
    out = tmp_path / "a.html"
    command = ["convert", str(tmp_path / "after.ply"), str(out)]
    assert main([*command, "--before", str(tmp_path / "before.ply")]) == 0
    flags = {name.lower(): unpacked(out, name)[14] for name in ("Before", "After")}
    assert flags == {"before": 0, "after": 0} | {smooth: 1}


def test_fifty_thousand_gaussians_are_two_and_a_half_megabytes(tmp_path: Path) -> None:
    """Random numbers, which compress worse than those of a scene."""
    formats.write(tmp_path / "a.html", arrays(50_000))
    assert (tmp_path / "a.html").stat().st_size <= 2.5e6


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


def test_a_wheel_holds_the_parts_of_a_page(tmp_path: Path) -> None:
    """A wheel contains the files of `build_py`, besides the kernels."""
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
