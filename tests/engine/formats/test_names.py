"""Names of any length and of any marks: compared soon."""

from __future__ import annotations

import time
import unicodedata
from pathlib import Path

import pytest

from roigs_engine.cli import main
from roigs_engine.formats.names import first_taken, same_name
from tests.addon.colmap_project import write_project

MARKS = "\u0301\u0316" * 100_000  # an accent above and one below, which NFC puts in order


def test_accents_have_one_form() -> None:
    name = "Café/naïve.jpg"
    assert same_name(unicodedata.normalize("NFD", name)) == same_name(name.upper())
    assert first_taken([name, unicodedata.normalize("NFD", name)])


def test_a_run_of_marks_takes_no_minutes() -> None:
    began = time.process_time()
    assert same_name(f"a{MARKS}") == same_name(f"A{MARKS}")
    assert first_taken([f"a{MARKS}", f"b{MARKS}"]) is None
    assert time.process_time() - began < 2


@pytest.mark.parametrize("name", [f"a{MARKS}.png", f"a/{MARKS}/b.png", "a" * 400_000])
def test_a_model_with_a_name_that_no_file_has(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    scene = write_project(tmp_path / "scene")
    images = scene / "sparse" / "0" / "images.txt"
    text = images.read_text(encoding="utf-8")
    images.write_text(text.replace("photo 0.png", name), encoding="utf-8")
    began = time.process_time()
    assert main(["inspect", str(scene)]) in (0, 2)
    assert time.process_time() - began < 4
    assert len(capsys.readouterr().err) < 5000
