"""Folder of a refined model: written whole or not at all, never through links of a project."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

import pycolmap
import pytest

from roigs_engine.errors import SceneError
from roigs_engine.formats.projects import is_refined_model
from tests.engine.colmap.bent_models import bent
from tests.engine.commands.command_line import refused
from tests.engine.exchanged_models import refined
from tests.engine.killing import killed_everywhere

pytestmark = pytest.mark.skipif(os.name != "posix", reason="SIGKILL and links are POSIX's")


def test_killed_at_any_moment_it_is_there_or_not(tmp_path: Path) -> None:
    model, start, folder = tmp_path / "model/sparse/0", tmp_path / "start", tmp_path / "project"
    bent(tmp_path / "model")
    (start / "refined").mkdir(parents=True)
    made, moments = folder / "refined", list[int]()
    for number in killed_everywhere(start, folder, partial(refined, model, made)):
        moments.append(number)
        assert is_refined_model(made) or not made.exists() or not list(made.iterdir())
        if not is_refined_model(made):
            refined(model, made)
            assert [path.name for path in folder.iterdir()] == ["refined"]
        assert pycolmap.Reconstruction(str(made)).num_reg_images() == 10
    assert len(moments) > 4, "it makes more changes than that"


def test_a_model_that_came_meanwhile_stays(tmp_path: Path) -> None:
    bent(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out/cameras.bin").write_bytes(b"theirs")
    with pytest.raises(SceneError, match="Cannot write"):
        refined(tmp_path / "sparse/0", tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["cameras.bin"]


@pytest.mark.parametrize("link", ["sparse", "sparse/refined"])
def test_a_projects_links_lead_nowhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], link: str
) -> None:
    project, theirs = tmp_path / "project", tmp_path / "theirs"
    bent(project)
    theirs.mkdir()
    if link == "sparse":
        (project / "sparse").rename(theirs / "sparse")
        theirs = theirs / "sparse"
    (project / link).symlink_to(theirs)
    before = sorted(theirs.rglob("*"))
    said = refused(capsys, "refine-cameras", project, "--tracks-only")
    assert f"{project / link} is a link" in said
    assert sorted(theirs.rglob("*")) == before
