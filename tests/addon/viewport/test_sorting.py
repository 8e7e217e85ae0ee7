"""Orders of Gaussians for the viewport, and the thread that finds them."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from roigs_addon.viewport.sorting import (
    TURN,
    Segment,
    SortingView,
    ascending,
    back_to_front,
    depths,
)
from roigs_addon.worker import Worker


def test_sorts_like_a_stable_sort() -> None:
    random = np.random.default_rng(0)
    values = random.normal(size=5000).astype(np.float32) * 10.0 ** random.integers(-40, 38, 5000)
    values = np.concatenate([values, values[::3], [0.0, -0.0, np.inf, -np.inf]], dtype=np.float32)
    np.testing.assert_array_equal(values[ascending(values)], np.sort(values))
    tied = np.repeat(np.float32([3, -1, 2]), 40)
    np.testing.assert_array_equal(ascending(tied), np.argsort(tied, kind="stable"))


def test_several_objects_share_one_order() -> None:
    means = np.zeros((6, 3), np.float32)
    means[:, 2] = [1, 2, 3, 1, 2, 9]
    near = Segment(0, 3, np.array([0.0, 0, 1]), 1e9)
    far = Segment(3, 5, np.array([0.0, 0, 2]), 1e9 - 1.5)
    np.testing.assert_allclose(depths(means, [near, far]), [1, 2, 3, 0.5, 2.5])
    assert back_to_front(means, SortingView((near, far), 1.0)).tolist() == [2, 4, 1, 0, 3]
    # Row 5 belongs to neither: it is hidden.
    assert back_to_front(means, SortingView((), 1.0)).tolist() == []


def view(*parts: tuple[tuple[float, float, float], float], extent: float = 1.0) -> SortingView:
    """Objects of ten Gaussians each, by axis and offset."""
    segments = [
        Segment(10 * k, 10 * k + 10, np.array(axis), offset)
        for k, (axis, offset) in enumerate(parts)
    ]
    return SortingView(tuple(segments), extent)


def test_a_new_order_only_when_the_view_turns() -> None:
    axis, other = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
    held = view((axis, 3.0), (other, 5.0))
    assert not held.differs(held)
    assert not held.differs(view((axis, 13.0), (other, 15.0)))  # the camera slides
    assert not held.differs(view(((0.0, 0.0, 2.0), 6.0), ((0.0, 2.0, 0.0), 10.0)))  # all scaled
    assert not held.differs(view(((TURN / 2, 0.0, 1.0), 3.0), (other, 5.0)))
    assert held.differs(view(((2 * TURN, 0.0, 1.0), 3.0), (other, 5.0)))  # the camera turns
    assert held.differs(view((axis, 3.0), ((0.0, 2.0, 0.0), 5.0)))  # an object is scaled
    assert held.differs(view((axis, 3.0), (other, 5.1)))  # an object moves
    assert held.differs(view((axis, 3.0)))  # an object is hidden
    assert not view().differs(view())


def test_a_worker_does_the_newest_task_of_a_name() -> None:
    worker, go, begun = Worker("test"), threading.Event(), threading.Event()
    done: list[str] = []

    def slow() -> str:
        begun.set()
        go.wait(10)
        return "slow"

    worker.submit("a", slow)
    assert begun.wait(10)
    for name in ("first", "second"):
        worker.submit("b", lambda name=name: done.append(name) or name)
    assert worker.pending("a") and worker.busy("b") and not worker.idle()
    assert worker.take("a") is None
    go.set()
    deadline = time.monotonic() + 10
    while not worker.idle() and time.monotonic() < deadline:
        time.sleep(0.001)
    assert done == ["second"]
    assert worker.pending("b") and not worker.busy("b")
    assert worker.take("b").value == "second" and worker.take("b") is None
    worker.forget("a")
    assert not worker.pending("a")
    worker.close()


def test_a_worker_survives_a_failing_task() -> None:
    worker = Worker("test")
    worker.submit("a", lambda: 1 / 0)
    while worker.busy("a"):
        time.sleep(0.001)
    outcome = worker.take("a")
    assert outcome is not None and isinstance(outcome.error, ZeroDivisionError)
    worker.submit("a", lambda: 3)
    while worker.busy("a"):
        time.sleep(0.001)
    assert worker.take("a").value == 3
    worker.close()
    worker.submit("a", lambda: 4)
    assert worker.idle()
    assert not [t for t in threading.enumerate() if t.name == "test"]


@pytest.mark.slow
def test_a_million_are_sorted_faster_than_numpy_sorts_floats() -> None:
    values = np.random.default_rng(0).normal(size=1_000_000).astype(np.float32)
    ours, theirs = [], []
    for _ in range(5):
        for times, sort in ((ours, ascending), (theirs, lambda v: np.argsort(v, kind="stable"))):
            start = time.thread_time()
            sort(values)
            times.append(time.thread_time() - start)
    assert np.median(ours) < np.median(theirs)
