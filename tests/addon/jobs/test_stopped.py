"""Messages about jobs that were stopped or killed."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from tests.addon.fake_engine import fake

pytestmark = pytest.mark.blender


@pytest.mark.parametrize(
    ("title", "resume"),
    [
        ("TRAINING", " Click 'Continue' to resume."),
        ("RECONSTRUCTING", " Click 'Continue' to resume."),
        ("LEVELS", " Click 'Make Levels' to resume."),
        ("EXPORTING", ""),
        ("MASKING", ""),
        ("FLOATERS", ""),
    ],
)
def test_a_stopped_job_says_what_resumes_it(
    blender: ModuleType, tmp_path: Path, title: str, resume: str
) -> None:
    from roigs_addon.jobs import current
    from roigs_addon.jobs import spec as specs

    ends = {
        "say(event='done', outputs={}, stopped=True)": f"Stopped.{resume}",
        "os.kill(os.getpid(), 9)": f"The engine was ended from outside (signal 9).{resume}",
    }
    for number, (code, text) in enumerate(ends.items()):
        job = specs.JobSpec(
            title=getattr(specs, title), arguments=["train"], log=tmp_path / "log.txt"
        )
        current.wait(current.start(fake(tmp_path / str(number), code), job))
        state = current.state()
        assert (state.error or state.message) == text


def test_a_panel_says_that_its_job_was_stopped(blender: ModuleType, run, tmp_path: Path) -> None:
    from roigs_addon.jobs import current
    from roigs_addon.jobs.spec import MASKING, JobSpec
    from roigs_addon.ui.masks import MasksPanel
    from tests.addon.panels import said

    code = "say(event='done', outputs={}, stopped=True)"
    spec = JobSpec(title=MASKING, arguments=["masks"], log=tmp_path / "log.txt")
    current.wait(current.start(fake(tmp_path, code), spec))
    text = " ".join(said(blender, MasksPanel))
    assert "Stopped." in text and "Continue" not in text
