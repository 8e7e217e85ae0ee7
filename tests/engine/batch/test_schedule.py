"""The order of parts, and what becomes of those that fail."""

from __future__ import annotations

import pytest

from roigs_engine.batch import schedule
from roigs_engine.batch.board import Board
from roigs_engine.batch.engine_process import DONE, FAILED, LOST, STOPPED, Outcome
from roigs_engine.batch.local import Report
from roigs_engine.batch.makespan import lower_bound, makespan
from roigs_engine.batch.parts import Part
from roigs_engine.batch.schedule import RUNNING, PartState, Scheduler, share, straggler
from roigs_engine.context import QUIET, Context
from roigs_engine.errors import Stopped
from tests.engine.batch.parts_of_scenes import Instant, part, scene

WIDE = scene(
    "wide",
    part("wide", "prepare", work=0),
    part("wide", "one", "prepare", work=3),
    part("wide", "two", "prepare", work=9),
    part("wide", "all", "prepare", "one", "two"),
)
SMALL = scene("small", part("small", "all", work=5))
LARGE = scene("large", part("large", "all", work=50))


def scheduler(executor: Instant, *scenes, retries: int = 0, context: Context = QUIET) -> Scheduler:  # type: ignore[no-untyped-def]
    return Scheduler(scenes, executor, context, retries=retries, told=lambda *_: None)


def test_needs_first_then_the_longest_way_to_the_end() -> None:
    executor = Instant()
    made = scheduler(executor, SMALL, WIDE, LARGE)
    made.run()
    assert executor.order == ["large", "wide: prepare", "wide: two", "small", "wide: one", "wide"]
    assert {state.state for state in made.scenes.values()} == {DONE}


def test_what_is_done_is_not_done_again() -> None:
    executor = Instant()
    scheduler(executor, scene("old", part("old", "all"), done=True), SMALL).run()
    assert executor.order == ["small"]


def test_a_part_that_fails_ends_its_scene_alone() -> None:
    def ends(part, avoid):  # type: ignore[no-untyped-def]
        failed = part.label == "wide: two"
        return Outcome(state=FAILED, reason="No photo.") if failed else Outcome(state=DONE)

    said: list[str] = []
    made = scheduler(
        Instant(ends), SMALL, WIDE, context=Context(emit=lambda e: said.append(e.text))
    )  # type: ignore[union-attr]
    made.run()
    assert made.scenes["wide"].reason == "wide: two: No photo."
    assert made.scenes["wide"].state == FAILED and made.scenes["small"].state == DONE
    assert said == ["wide: two: No photo. The other scenes go on."]
    assert "1 failed" in Board(made.scenes, 0.0).head()


@pytest.mark.parametrize(("losses", "state"), [(2, DONE), (3, FAILED)])
def test_a_lost_part_is_tried_again_so_many_times(losses: int, state: str) -> None:
    left = [losses]

    def ends(part, avoid):  # type: ignore[no-untyped-def]
        left[0] -= 1
        return Outcome(state=LOST, reason="Killed.") if left[0] >= 0 else Outcome(state=DONE)

    made = scheduler(Instant(ends), SMALL, retries=2)
    made.run()
    assert made.scenes["small"].state == state


def test_an_error_is_tried_on_other_machines_first() -> None:
    def ends(part, avoid):  # type: ignore[no-untyped-def]
        return Outcome(state=FAILED, reason="Full disk.", node=f"node {len(avoid)}")

    executor = Instant(ends, machines=9)
    made = scheduler(executor, SMALL)
    made.run()
    assert executor.avoided == [(), ("node 0",), ("node 0", "node 1")]
    assert made.scenes["small"].reason == "small: Full disk."


def test_a_stop_waits_for_what_runs_and_starts_nothing() -> None:
    asked = [False]

    def ends(part, avoid):  # type: ignore[no-untyped-def]
        asked[0] = True
        return Outcome(state=STOPPED)

    executor = Instant(ends)
    with pytest.raises(Stopped):
        scheduler(executor, SMALL, LARGE, context=Context(should_stop=lambda: asked[0])).run()
    assert executor.order == ["large"]


def progress(stage: str, step: int) -> dict[str, object]:
    return {"event": "progress", "stage": stage, "step": step, "total": 100}


def test_the_share_of_a_part_that_has_several_stages() -> None:
    stages = (("scene", 2.0), ("joint", 6.0), ("", 2.0))  # the last: evaluation
    whole = Part(scene="a", name="all", argv=(), work=10, stages=stages)
    state = PartState(part=whole, state=RUNNING)
    for stage, step, expected in (
        *(("photos", 50, 0.0), ("scene", 50, 0.1), ("joint", 0, 0.2), ("joint", 50, 0.5)),
        ("evaluate", 10, 0.8),
    ):
        state.progress = progress(stage, step)
        assert share(state) == pytest.approx(expected)
    state.state = DONE
    assert share(state) == 1


def slow_scenes(step: int) -> list[PartState]:
    """Three parts that took 100 s each, and one that has done a part of its steps in 100 s."""
    states = [PartState(part=part(name, "all", work=10)) for name in "abcd"]
    for state in states[:3]:
        state.state, state.first, state.seconds = DONE, (1.0, 0.0), 100.0
        state.started = 1.0
    last = states[3]
    last.state, last.first, last.progress = RUNNING, (1.0, 0.0), progress("joint", step)
    return states


def test_a_part_on_a_slow_machine_goes_on_elsewhere_once() -> None:
    states = slow_scenes(30)  # 333 s in all, 233 s of them left
    assert straggler(states, 101.0) is states[3]
    states[3].avoid = ("slow",)
    assert straggler(states, 101.0) is None
    assert straggler(slow_scenes(60), 101.0) is None  # 167 s in all
    assert straggler(slow_scenes(30)[2:], 101.0) is None  # nothing to compare with


def test_a_moved_part_avoids_its_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    class Waiting(Instant):
        def wait(self, seconds: float) -> list[Report]:
            return super().wait(seconds) if self.asked else []

    ends = iter([Outcome(state=STOPPED, node="slow"), Outcome(state=DONE, node="fast")])
    executor = Waiting(lambda part, avoid: next(ends), room=2, machines=2)
    made = scheduler(executor, SMALL)
    state = made.scenes["small"].parts["all"]
    monkeypatch.setattr(
        schedule, "straggler", lambda states, now: state if not executor.asked else None
    )
    made.run()
    assert executor.asked == ["small"]
    assert executor.avoided == [(), ("slow",)]
    assert made.scenes["small"].state == DONE


def test_makespan_of_parts_on_machines() -> None:
    scenes = [s.parts for s in (WIDE, SMALL, LARGE)]
    seconds = {p.key: p.work for parts in scenes for p in parts}
    assert makespan(scenes, seconds, 1) == sum(seconds.values()) == 68
    assert makespan(scenes, seconds, 10) == 50
    for workers in (1, 2, 3):
        assert makespan(scenes, seconds, workers) >= lower_bound(scenes, seconds, workers)
