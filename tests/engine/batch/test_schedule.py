"""The order of parts, and what becomes of those that fail."""

from __future__ import annotations

import pytest

from roigs_engine.batch import schedule
from roigs_engine.batch.board import Reporter
from roigs_engine.batch.engine_process import DONE, FAILED, LOST, STOPPED, Outcome
from roigs_engine.batch.local import Report
from roigs_engine.batch.moves import Move
from roigs_engine.batch.schedule import Scheduler
from roigs_engine.batch.times import makespan
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
    assert said == ["wide: two: No photo. The other scenes continue."]
    assert "1 failed" in Reporter(made.scenes, QUIET).head()


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


@pytest.mark.parametrize(("slow", "avoided"), [(True, [(), ("here",)]), (False, [(), ()])])
def test_a_moved_part_avoids_its_machine_if_that_is_slow(
    slow: bool, avoided: list[tuple[str, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Waiting(Instant):
        def wait(self, seconds: float) -> list[Report]:
            return super().wait(seconds) if self.asked else []

    ends = iter([Outcome(state=STOPPED, node="here"), *3 * [Outcome(state=DONE, node="there")]])
    executor = Waiting(lambda part, avoid: next(ends), machines=2)
    made = scheduler(executor, SMALL)
    state = made.scenes["small"].parts["all"]
    move = Move(state=state, slow=slow)
    monkeypatch.setattr(schedule, "next_move", lambda *_, **__: None if executor.asked else move)
    made.run()
    assert executor.asked == ["small"]
    assert executor.avoided == avoided
    assert made.scenes["small"].state == DONE


def test_what_is_left_of_a_part_decides_when_its_turn_is() -> None:
    """Of two parts that were lost, the one with more left goes on first."""
    executor = Instant()
    made = scheduler(executor, SMALL, LARGE)
    made.scenes["large"].parts["all"].kept = 0.95  # 2.5 of 50 left; small has 5
    made.run()
    assert executor.order == ["small", "large"]


def test_makespan_of_parts_on_machines() -> None:
    scenes = [s.parts for s in (WIDE, SMALL, LARGE)]
    seconds = {p.key: p.work for parts in scenes for p in parts}
    assert makespan(scenes, seconds, 1) == sum(seconds.values()) == 68
    assert makespan(scenes, seconds, 10) == 50
    for workers in (2, 3):
        assert makespan(scenes, seconds, workers) >= max(50, 68 / workers)
