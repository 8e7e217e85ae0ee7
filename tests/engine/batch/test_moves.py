"""Parts that move to another machine or a later time."""

from __future__ import annotations

from dataclasses import replace

import pytest

from roigs_engine.batch.engine_process import DONE
from roigs_engine.batch.moves import RUNNING, Move, PartState, next_move, share
from roigs_engine.batch.parts import Part
from tests.engine.batch.parts_of_scenes import part

NOW = 1000.0  # seconds; a unit of work usually takes 10


def progress(stage: str, step: float, total: float = 100) -> dict[str, object]:
    return {"event": "progress", "stage": stage, "step": step, "total": total}


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
    state.kept, state.progress = 0.4, {}  # stopped, and given out again
    assert share(state) == pytest.approx(0.4)
    state.state = DONE
    assert share(state) == 1


def done(name: str, work: float = 10) -> PartState:
    state = PartState(part=part(name, "all", work=work), state=DONE)
    state.started, state.seconds, state.first = 100.0, 10 * work, (100.0, 0.0)
    return state


def running(name: str, work: float, *, percent: float, since: float) -> PartState:
    """It has done so much of its work in so many seconds."""
    state = PartState(part=part(name, "all", work=work), state=RUNNING)
    state.first, state.progress = (NOW - since, 0.0), progress("joint", percent)
    return state


def waiting(name: str, work: float, kept: float = 0.0) -> PartState:
    return PartState(part=part(name, "all", work=work), kept=kept)


def found(*states: PartState, idle: bool = False) -> Move | None:
    after = {state.part.key: 0.0 for state in states}
    ready = [state for state in states if state.state == "waiting"]
    return next_move(states, after, ready, NOW, idle=idle)


USUAL = [done("a"), done("b"), done("c")]


def test_a_slow_part_goes_on_at_an_idle_machine() -> None:
    slow = running("slow", 10, percent=30, since=100)  # 233 s left; usual are 70
    assert found(*USUAL, slow, idle=True) == Move(state=slow, slow=True)
    assert found(*USUAL, slow) is None
    assert found(*USUAL[2:], slow, idle=True) is None  # too little to compare with
    usual = running("usual", 10, percent=60, since=100)
    assert found(*USUAL, usual, idle=True) is None
    ending = running("ending", 10, percent=90, since=300)  # 33 s left
    assert found(*USUAL, ending, idle=True) is None
    slow.cores = 4  # nothing is known of parts with so many
    assert found(*USUAL, slow, idle=True) is None
    slow.cores, slow.avoid = 1, ("one", "two", "three")
    assert found(*USUAL, slow, idle=True) is None


def test_a_scene_without_a_gpu_is_not_compared_with_those_on_one() -> None:
    slow = running("cpu", 10, percent=30, since=100)
    cards = [done(name) for name in "abc"]
    assert found(*cards, slow, idle=True) == Move(state=slow, slow=True)
    for state in cards:
        state.part = replace(state.part, gpu=True)
    assert found(*cards, slow, idle=True) is None


def test_a_slow_part_leaves_in_time_for_the_others() -> None:
    """Parts that wait do not keep it, if it would end after all of them."""
    slow = running("slow", 40, percent=20, since=300)  # 1200 s left; usual are 320
    usual = running("usual", 40, percent=50, since=200)  # 200 s left
    few, many = [waiting("d", 20)], [waiting(f"w{k}", 40) for k in range(8)]
    # On two machines: the rest takes (200 + 1200 + 200) / 2, or (200 + 1200 + 3200) / 2 seconds.
    assert found(*USUAL, slow, usual, *few) == Move(state=slow, slow=True)
    assert found(*USUAL, slow, usual, *many) is None


def test_a_short_part_makes_way_for_a_long_one_that_was_lost() -> None:
    short = running("short", 40, percent=60, since=240)  # 160 s left
    others = [running(f"o{k}", 40, percent=50, since=200) for k in range(3)]  # 200 s each
    lost = waiting("lost", 50, kept=0.1)  # 450 s left
    # On four machines, the rest takes (160 + 600 + 450) / 4 = 303 s.
    assert found(*USUAL, short, *others, lost) == Move(state=short, slow=False)
    assert found(*USUAL, short, *others, waiting("lost", 50, kept=0.5)) is None  # 250 s left
    short.made_way = True
    chosen = found(*USUAL, short, *others, lost)
    assert chosen is not None and chosen.state in others
    others[1].moving = True  # one at a time
    assert found(*USUAL, short, *others, lost) is None


def test_what_waits_for_a_part_counts() -> None:
    """A part that others wait for is longer than it looks: it does not make way."""
    first = running("first", 40, percent=60, since=240)
    others = [running(f"o{k}", 40, percent=50, since=200) for k in range(3)]
    lost = waiting("lost", 50, kept=0.1)
    states = [*USUAL, first, *others, lost]
    after = {state.part.key: 0.0 for state in states} | {first.part.key: 40.0}
    chosen = next_move(states, after, [lost], NOW, idle=False)
    assert chosen is not None and chosen.state in others


def test_too_little_progress_says_nothing() -> None:
    fresh = [running(name, 10, percent=1, since=10) for name in "abc"]
    slow = running("slow", 10, percent=30, since=100)
    assert found(*fresh, slow, idle=True) is None


@pytest.mark.parametrize("machines", [20, 100])
def test_a_simulated_batch_ends_near_its_bound(machines: int) -> None:
    """200 scenes; 5 % of the machines are lost an hour, 5 % are three times as slow."""
    from benchmarks.cluster_model import World, simulate

    scenes = [600.0 + 3 * k for k in range(200)]
    run = simulate(scenes, World(machines))
    assert 1 <= run.seconds / run.bound <= 1.2
