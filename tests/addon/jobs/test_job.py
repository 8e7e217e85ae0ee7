"""Jobs in Blender: state, previews, results, undo; with an engine made for the test."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from roigs_addon.engine.command import Engine
from tests.addon.fake_engine import LISTEN, alive, fake, until

pytestmark = pytest.mark.blender


def test_progress_becomes_the_state(blender: ModuleType, spec, tmp_path: Path) -> None:
    from roigs_addon.jobs import current

    engine = fake(
        tmp_path,
        """
        say(event="stagestarted", stage="scene", total=30)
        say(event="progress", stage="joint", step=12, total=30, loss=0.25, psnr=21.5,
            gaussians=1234, seconds_left=125.4)
        say(event="message", text="Something", level="info")
        say(event="done", outputs={}, stopped=False)
        """,
    )
    job = current.start(engine, spec())
    while job.poll():
        time.sleep(0.02)
    state = current.state()
    assert (state.step, state.total, state.gaussians) == (12, 30, 1234)
    assert (state.loss, state.psnr) == (0.25, 21.5)
    assert len(spec.taken) == 1 and not current.busy()
    for level in ("info", "detail"):  # the second one is for the log
        state.take({"event": "message", "text": level, "level": level})
    assert state.message == "info"
    state.stage = "joint"
    text = state.in_words()
    assert text == "joint 12 / 30, 21.5 dB, 1,234 Gaussians, about 2 minutes left in this part"
    state.take({"event": "progress", "stage": "joint", "run_seconds_left": 400.0})
    assert state.time_left() == "about 7 minutes left"  # of all stages


def test_warnings_stay_in_the_panel(blender: ModuleType, spec, tmp_path: Path) -> None:
    """Messages replace each other; what was warned of is still there when the job has ended."""
    from roigs_addon.jobs import current
    from roigs_addon.jobs.spec import TRAINING
    from roigs_addon.ui.train import TrainPanel
    from tests.addon.panels import said

    warning = "say(event='message', text='Only 3 photos see it', level='warning')"
    code = f"{warning}; {warning}; say(event='message', text='Something', level='info')"
    code += "; say(event='done', outputs={}, stopped=False)"
    current.wait(current.start(fake(tmp_path, code), spec(title=TRAINING)))
    assert current.state().warnings == ["Only 3 photos see it"]
    assert any("Only 3 photos see it" in text for text in said(blender, TrainPanel))


def test_warnings_of_training_outlast_other_jobs(blender: ModuleType, spec, tmp_path: Path) -> None:
    """Until the next training, or another file."""
    from roigs_addon.jobs import current
    from roigs_addon.jobs.spec import SELECTING, TRAINING
    from roigs_addon.ui.train import TrainPanel
    from tests.addon.panels import said

    def shown(*warnings: str, title: str) -> list[str]:
        """The last words of the panel's texts, after a job with these warnings."""
        code = [f"say(event='message', text='It saw {w}', level='warning')" for w in warnings]
        code.append("say(event='done', outputs={}, stopped=False)")
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        current.wait(current.start(fake(folder, "; ".join(code)), spec(title=title)))
        texts = said(blender, TrainPanel)
        return [text.rpartition(" ")[2] for text in texts if "It saw" in text]

    assert shown("a", "b", title=TRAINING) == ["a", "b"]
    assert shown("c", title=SELECTING) == ["a", "b"]
    assert shown("d", title=TRAINING) == ["d"]
    assert shown(title=TRAINING) == []
    assert shown("e", title=TRAINING) == ["e"] == shown(title=SELECTING)
    blender.ops.wm.read_homefile(use_empty=True)
    assert shown(title=SELECTING) == []


def test_a_job_is_seen_and_stopped_after_a_file_was_loaded(
    blender: ModuleType, spec, tmp_path: Path
) -> None:
    from roigs_addon.jobs import current
    from roigs_addon.jobs.state import STOPPING

    engine = fake(
        tmp_path,
        """
        say(event="stagestarted", stage="scene", total=30)
        say(event="progress", stage="joint", step=12, total=30, gaussians=1234)
        say(event="message", text="Something", level="info")
        sys.stdin.read()
        say(event="done", outputs={}, stopped=True)
        """,
    )
    job = current.start(engine, spec())
    job.hears_esc = True
    assert until(lambda: job.poll() and current.state().message == "Something")
    blender.ops.wm.read_homefile(use_empty=True)
    state = current.state()
    assert (state.title, state.stage, state.message) == ("Testing", "joint", "Something")
    assert (state.step, state.total, state.gaussians) == (12, 30, 1234)
    assert state.log.name == "log.txt" and not job.hears_esc
    assert blender.ops.roigs.stop() == {"FINISHED"}
    blender.ops.wm.read_homefile(use_empty=True)
    assert current.state().message == STOPPING
    assert current.wait(job).stopped


def test_no_preview_is_drawn_while_the_engine_stops(
    blender: ModuleType, spec, tmp_path: Path
) -> None:
    from roigs_addon.jobs import current

    first, last = tmp_path / "first.ply", tmp_path / "last.ply"
    first.touch()
    last.touch()
    engine = fake(
        tmp_path,
        f"""
        say(event="preview", path={str(first)!r})
        sys.stdin.read()
        say(event="preview", path={str(last)!r})
        time.sleep(0.5)
        say(event="done", outputs={{}}, stopped=True)
        """,
    )
    shown: list[Path] = []
    job = current.start(engine, spec(on_preview=shown.append, folder=tmp_path))
    assert until(lambda: job.poll() and bool(shown))
    job.stop()
    while job.poll():
        assert shown == [first]
        time.sleep(0.02)
    assert shown == [first, last] and job.result.stopped


def test_nothing_is_imported_while_blender_renders(
    blender: ModuleType, spec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Replacing a mesh would crash a render in a window; progress goes on, and nothing is lost."""
    from roigs_addon.jobs import current
    from roigs_addon.jobs.state import WAITING

    made, go = tmp_path / "made.ply", tmp_path / "go"
    made.touch()
    engine = fake(
        tmp_path,
        f"""
        say(event="preview", path={str(made)!r})
        say(event="progress", stage="joint", step=1, total=3)
        while not os.path.exists({str(go)!r}):
            time.sleep(0.01)
        say(event="progress", stage="joint", step=2, total=3)
        say(event="message", text="Only 3 photos see it", level="warning")
        say(event="done", outputs={{}}, stopped=False)
        """,
    )
    rendering = [True]
    monkeypatch.setattr(current, "is_rendering", lambda: rendering[0])
    shown: list[Path] = []
    job = current.start(engine, spec(on_preview=shown.append, folder=tmp_path, done_text="Made."))
    assert until(lambda: current._poll() and current.state().step == 1)
    go.touch()
    assert until(lambda: current._poll() and current.state().message == WAITING)
    assert current.busy() and current.state().step == 2 and not shown and not spec.taken
    job.news = False
    assert current._poll() and not job.news  # it is said once
    rendering[0] = False
    assert not current._poll()
    assert shown == [made] and spec.taken == ["done"]
    state = current.state()
    assert (state.outcome, state.message) == ("Made.", "")
    assert state.warnings == ["Only 3 photos see it"]


def test_a_failure_does_not_wait_for_a_render(
    blender: ModuleType, spec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from roigs_addon.jobs import current

    monkeypatch.setattr(current, "is_rendering", lambda: True)
    current.start(fake(tmp_path, 'say(event="error", message="Disk full.", hint="")'), spec())
    assert until(lambda: not current._poll())
    assert "Disk full." in current.state().error and not spec.taken


def test_odd_numbers_do_no_harm(blender: ModuleType, spec, tmp_path: Path) -> None:
    from roigs_addon.jobs import current

    odd = ["NaN", "Infinity", "-Infinity", "1e400", "-1e30", "9" * 400, '"x"', "null", "[]", "{}"]
    lines = [
        f'{{"event": "{kind}", "stage": {v}, "step": {v}, "total": {v}, "loss": {v}, "psnr": {v},'
        f' "gaussians": {v}, "seconds_left": {v}, "text": {v}, "path": {v}}}'
        for v in odd
        for kind in ("stagestarted", "progress", "message", "preview")
    ]
    (tmp_path / "lines").write_text("\n".join([*lines, '{"event": "progress"}', ""]))
    code = f"print(open({str(tmp_path / 'lines')!r}).read(), flush=True)\nsay(event='done')"
    job = current.start(fake(tmp_path, code), spec())
    result = current.wait(job)
    assert not result.failed and len(spec.taken) == 1
    assert current.state().in_words()


def test_odd_texts_do_no_harm(blender: ModuleType, spec, tmp_path: Path) -> None:
    from roigs_addon.jobs import current

    odd = ["a\0b", "\ud800", "\udcff", "x" * 60_000, "\x1b[2J", "a\nb", "\u202e", "{}%s"]
    code = "\n".join(
        f"say(event={kind!r}, stage={text!r}, text={text!r}, path={text!r})"
        for text in odd
        for kind in ("stagestarted", "progress", "message", "preview")
    )
    taken: list[Path] = []
    code += "\nsay(event='failed', message='\\ud800 no', hint='a\\0b'); sys.exit(2)"
    given = spec(folder=tmp_path, on_preview=taken.append)
    result = current.wait(current.start(fake(tmp_path, code), given))
    assert result.failed and "no" in current.state().error
    assert not taken


def test_previews_outside_the_run_are_not_looked_at(
    blender: ModuleType, spec, tmp_path: Path
) -> None:
    from roigs_addon.jobs import current

    run = tmp_path / "run"
    run.mkdir()
    (run / "preview.ply").write_text("mine")
    (tmp_path / "secret").write_text("not mine")
    (run / "link.ply").symlink_to(tmp_path / "secret")
    (run / "loop").symlink_to(run / "loop")
    paths = [tmp_path / "secret", run / ".." / "secret", run / "link.ply", run / "loop", run,
             "/etc/passwd", "/dev/zero", "preview.ply", "a\0b", run / "preview.ply"]  # fmt: skip
    code = "\n".join(f"say(event='preview', path={str(path)!r})" for path in paths)
    taken: list[Path] = []
    for folder, expected in ((run, [run / "preview.ply"]), (None, [])):
        taken.clear()
        given = spec(folder=folder, on_preview=taken.append)
        current.wait(current.start(fake(tmp_path / str(folder is None), code), given))
        assert taken == expected


def test_one_job_at_a_time_and_none_outlives_the_addon(
    blender: ModuleType, spec, tmp_path: Path
) -> None:
    from roigs_addon.errors import AddonError
    from roigs_addon.jobs import current

    engine = fake(tmp_path, LISTEN)
    job = current.start(engine, spec())
    assert current.busy()
    with pytest.raises(AddonError, match="busy"):
        current.start(engine, spec())
    current.unregister()
    assert not alive(job.process.pid) and not current.busy() and not spec.taken


def test_a_failed_result_is_an_error(blender: ModuleType, spec, tmp_path: Path) -> None:
    from roigs_addon.errors import AddonError
    from roigs_addon.jobs import current

    def refuse() -> None:
        raise AddonError("It does not fit.")

    engine = fake(tmp_path, 'say(event="done", outputs={})')
    assert current.wait(current.start(engine, spec(on_done=refuse))).message == "It does not fit."
    assert current.state().error == "It does not fit."

    def fall() -> None:
        raise RuntimeError("oh")

    assert "oh" in current.wait(current.start(engine, spec(on_done=fall))).message
    assert not current.busy()


def test_results_can_be_undone(
    blender: ModuleType, spec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With an undo step of their own, after they were imported."""
    from roigs_addon.errors import AddonError
    from roigs_addon.jobs import current, undo

    steps: list[str] = []
    monkeypatch.setattr(undo, "push", lambda title: steps.append(title))
    engine = fake(tmp_path, 'say(event="done", outputs={})')

    def take() -> None:
        assert not steps

    def refuse() -> None:
        raise AddonError("It does not fit.")

    assert not current.wait(current.start(engine, spec(on_done=take))).message
    assert steps == ["Testing"]
    current.wait(current.start(engine, spec(on_done=refuse)))
    current.wait(current.start(fake(tmp_path / "2", 'say(event="done", stopped=True)'), spec()))
    assert steps == ["Testing"]


def leaves(cls: type) -> Iterator[type]:
    """The classes below a class that none is made of."""
    below = cls.__subclasses__()
    for sub in below:
        yield from leaves(sub)
    if not below:
        yield cls


def test_no_undo_step_comes_before_the_results(addon: ModuleType) -> None:
    """Called by the file browser, such an operator ends before its engine does."""
    from roigs_addon.operators import (
        adapt,
        confidence,
        export,
        floaters,
        levels,
        masks,
        photos,
        reconstruct,
        relight,
        scene,
        stage,
        stand_here,
        suggest,
        surface,
        train,
    )
    from roigs_addon.operators import import_gaussians as imports
    from roigs_addon.operators.base import BrowsingOperator, EngineOperator

    running = (
        *(photos.SelectCameras, reconstruct.Reconstruct, scene.ImportColmap),
        *(scene.RefineCameras, train.EstimateTime, train.TrainRoi, export.ExportGaussians),
        *(imports.ImportGaussians, floaters.FindFloaters, levels.MakeLevels, masks.MakeMasks),
        *(adapt.AdaptResult, surface.MakeSurface, suggest.SuggestPhotos, relight.Relight),
        *(stage.LightFromScene, stage.CatchShadows, stand_here.StandHere),
        *(confidence.FindConfidence, suggest.CheckPhotos),
    )
    found = {*leaves(EngineOperator), *leaves(BrowsingOperator)}
    assert found == set(running)
    for cls in running:
        assert cls.is_registered and "UNDO" not in getattr(cls, "bl_options", ())


def test_esc_is_offered_where_it_is_heard(
    blender: ModuleType, spec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is not after the file browser, whose operator has ended."""
    from unittest.mock import MagicMock

    from roigs_addon.jobs import current
    from roigs_addon.ui import layout as panel

    monkeypatch.setattr(panel, "say", lambda *_: None)
    job = current.start(fake(tmp_path, LISTEN), spec())

    def shown() -> str:
        layout = MagicMock()
        panel.progress(layout, current.state())
        return str(layout.mock_calls)

    assert "Esc" not in shown()
    job.hears_esc = True
    assert "Esc" in shown()
    job.stop()
    assert "Esc" not in shown()
    current.wait(job)


def test_a_python_that_does_not_start(blender: ModuleType, spec, tmp_path: Path) -> None:
    from roigs_addon.errors import AddonError
    from roigs_addon.jobs import current

    with pytest.raises(AddonError, match="cannot be started"):
        current.start(Engine(python=tmp_path / "nowhere", source=tmp_path), spec())
    assert not current.busy()
