"""Loading a model says when refined cameras would be better, or where they are."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import Context
from roigs_engine.formats.events import Event, Message
from tests.engine.synthetic_colmap import camera, write_project

RADIAL = camera("SIMPLE_RADIAL", 96, 72, [100.0, 48.0, 36.0, 0.02])
OPENCV = camera("OPENCV", 96, 72, [100.0, 90.0, 40.0, 30.0, 0.01, 0, 0, 0])
PINHOLE = camera(params=[100.0, 90.0, 45.1, 39.6])


def messages(folder: Path) -> list[str]:
    """Messages of loading, without warnings."""
    said: list[Event] = []
    load_colmap(folder, pixels=False, context=Context(emit=said.append))
    return [event.text for event in said if isinstance(event, Message) and event.level == "info"]


def test_a_lens_with_few_parameters(tmp_path: Path) -> None:
    write_project(tmp_path, cameras=[RADIAL])
    (text,) = messages(tmp_path)
    assert "SIMPLE_RADIAL" in text and "refine-cameras" in text


@pytest.mark.parametrize("lens", [OPENCV, PINHOLE])
def test_other_lenses_need_no_word(tmp_path: Path, lens: object) -> None:
    write_project(tmp_path, cameras=[lens])
    assert not messages(tmp_path)


def test_without_observations_cameras_cannot_be_refined(tmp_path: Path) -> None:
    write_project(tmp_path, cameras=[RADIAL], tracks=False)
    assert not messages(tmp_path)


def test_the_refined_model_is_named(tmp_path: Path) -> None:
    write_project(tmp_path, cameras=[RADIAL])
    refined = tmp_path / "sparse" / "refined"
    shutil.copytree(tmp_path / "sparse" / "0", refined)
    (text,) = messages(tmp_path)
    assert str(refined) in text and "refined cameras" in text
