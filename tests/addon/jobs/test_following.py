"""A command that follows another one in the same job."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from roigs_addon.jobs.spec import nothing
from tests.addon.fake_engine import fake

pytestmark = pytest.mark.blender


def test_a_command_may_follow(
    blender: ModuleType, spec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the same job: one progress, one end, one undo step."""
    from roigs_addon.jobs import current, undo

    steps: list[str] = []
    monkeypatch.setattr(undo, "push", lambda title: steps.append(title))
    engine = fake(
        tmp_path,
        """
        say(event="progress", stage=sys.argv[1], step=1, total=2)
        say(event="message", text=sys.argv[1], level="warning")
        say(event="done", outputs={"made": sys.argv[1]})
        """,
    )
    ends: list[str] = []
    monkeypatch.setattr(current, "on_end", [lambda: ends.append(current.state().title)])
    given: list[dict[str, str]] = []

    def then(outputs):
        given.append(dict(outputs))
        return spec(title="Second", arguments=["b"], done_text="It is done.")

    job = current.start(engine, spec(arguments=["a"], on_done=lambda: spec.taken.append("a"),
                                     then=then, done_text="Nothing followed."))  # fmt: skip
    result = current.wait(job)
    assert not result.failed and result.outputs == {"made": "b"} and given == [{"made": "a"}]
    assert spec.taken == ["done"] and ends == steps == ["Second"]
    state = current.state()
    assert state.outcome == "It is done." and state.warnings == ["a", "b"] and not state.error
    # Nothing follows, and nothing has changed.
    current.wait(current.start(engine, spec(on_done=nothing, then=nothing, done_text="No more.")))
    assert current.state().outcome == "No more." and steps == ["Second"]


def test_what_follows_may_fail(blender: ModuleType, spec, tmp_path: Path) -> None:
    from roigs_addon.errors import AddonError
    from roigs_addon.jobs import current

    def refuse(_: object) -> None:
        raise AddonError("It does not fit.")

    engine = fake(
        tmp_path,
        """
        if sys.argv[1] == "a":
            say(event="done", outputs={})
        else:
            say(event="failed", message="It is broken.", hint="Mend it.")
            sys.exit(2)
        """,
    )
    for then, error in (
        (refuse, "It does not fit."),
        (lambda _: spec(arguments=["b"]), "It is broken. Mend it."),
    ):
        given = spec(arguments=["a"], then=then, done_text="It is done.")
        assert current.wait(current.start(engine, given)).message == error
        state = current.state()
        assert state.error == error and not state.outcome and not current.busy()
    assert not spec.taken


def test_nothing_follows_a_stop(blender: ModuleType, spec, tmp_path: Path) -> None:
    """Not even if the first command was finished before it heard of that."""
    from roigs_addon.jobs import current

    code = "sys.stdin.read(); say(event='done', outputs={}, stopped=False)"
    given = spec(then=lambda _: spec(arguments=["b"]), done_text="It is done.")
    job = current.start(fake(tmp_path, code), given)
    job.stop()
    assert current.wait(job).stopped
    assert not spec.taken and not current.state().outcome
