"""Leases on a store without locks: never two at once, and the dead are taken over."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import pytest

from roigs_engine.storage.lease import Lease, LeaseTakenError

PLACE = "/leases/hall"
QUICK = {"expiry": 0.6, "beat": 0.1}
PATIENT = {"expiry": 60.0, "beat": 0.05}  # however late a busy machine is with a heartbeat


@pytest.fixture
def store() -> Iterator[Any]:
    fsspec = pytest.importorskip("fsspec")
    found = fsspec.filesystem("memory")
    found.store.clear()
    yield found
    found.store.clear()


def test_one_that_is_alive_is_respected(store: Any) -> None:
    with Lease(store, PLACE, **PATIENT) as first:
        with pytest.raises(LeaseTakenError), Lease(store, PLACE, **PATIENT):
            pass
        assert first.is_held()
    assert not store.find(PLACE)
    with Lease(store, PLACE, **PATIENT):
        pass


def test_one_that_is_dead_is_taken_over_and_knows_it(store: Any) -> None:
    dead = Lease(store, PLACE, **QUICK)
    dead.__enter__()
    dead._ended.set()  # its machine is gone, or sleeps
    began = time.monotonic()
    with Lease(store, PLACE, **QUICK) as lease:
        assert time.monotonic() - began >= 0.5
        assert lease.is_held() and not dead.is_held()
        dead.__exit__()
        assert lease.is_held()


def test_a_store_that_does_not_answer_takes_no_lease_away(
    store: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever its package raises: who asks is a thread that also passes on stops."""

    def away(*_: Any, **__: Any) -> None:
        raise RuntimeError("EndpointConnectionError")

    with Lease(store, PLACE, **PATIENT) as lease:
        with monkeypatch.context() as broken:
            broken.setattr(type(store), "find", away)
            assert lease.is_held()
            time.sleep(0.2)  # some heartbeats
        assert lease.is_held()
        store.rm(PLACE, recursive=True)
        assert not lease.is_held()


def test_a_heartbeat_does_not_bring_a_lease_back(
    store: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may be under way when the lease is given back; the next engine would wait for its end."""
    beating, write = threading.Event(), type(store).pipe_file

    def slow(*given: Any, **more: Any) -> None:
        if threading.current_thread() is not threading.main_thread():
            beating.set()
            time.sleep(0.3)
        write(*given, **more)

    monkeypatch.setattr(type(store), "pipe_file", slow)
    with Lease(store, PLACE, **PATIENT):
        assert beating.wait(20)
    time.sleep(0.5)
    assert not store.find(PLACE)


def test_a_lease_that_cannot_be_given_back_ends_no_work(
    store: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def away(*_: Any) -> None:
        raise RuntimeError("EndpointConnectionError")

    with monkeypatch.context() as broken, Lease(store, PLACE, **PATIENT):
        broken.setattr(type(store), "rm_file", away)
    assert store.find(PLACE)  # it expires


def test_a_wait_can_be_stopped(store: Any) -> None:
    dead = Lease(store, PLACE, expiry=60, beat=0.1)
    dead.__enter__()
    dead._ended.set()
    with (
        pytest.raises(LeaseTakenError),
        Lease(store, PLACE, lambda: True, expiry=60, beat=0.1),
    ):
        pass
    assert len(store.find(PLACE)) == 1


def test_a_wait_is_said_once(store: Any) -> None:
    dead, said = Lease(store, PLACE, **QUICK), []
    dead.__enter__()
    dead._ended.set()
    with Lease(store, PLACE, waits=lambda: said.append(1), **QUICK):
        assert said == [1]


def test_of_many_at_once_one_is_inside(store: Any) -> None:
    rng, inside, most, taken = random.Random(3), [0], [0], [0]
    lock = threading.Lock()

    def work(delay: float) -> None:
        time.sleep(delay)
        with suppress(LeaseTakenError), Lease(store, PLACE, expiry=5, beat=0.05):
            with lock:
                inside[0] += 1
                taken[0] += 1
                most[0] = max(most[0], inside[0])
            time.sleep(0.1)
            with lock:
                inside[0] -= 1

    for _ in range(5):
        threads = [threading.Thread(target=work, args=(rng.uniform(0, 0.02),)) for _ in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30)
            assert not thread.is_alive()
    assert most[0] == 1 and taken[0] >= 5


def test_a_stop_is_heard_among_many_files(store: Any) -> None:
    """Anyone who can write to the store can write thousands; each is read."""
    for number in range(50):
        store.pipe_file(f"{PLACE}/{number:032x}", b"{}")
    read, cat_file = [], store.cat_file

    class Counted:
        def __getattr__(self, name: str) -> Any:
            return getattr(store, name)

        def cat_file(self, path: str) -> Any:
            read.append(path)
            return cat_file(path)

    lease = Lease(Counted(), PLACE, lambda: len(read) > 2, expiry=60, beat=0.1)  # type: ignore[arg-type]
    with pytest.raises(LeaseTakenError), lease:
        pass
    assert len(read) < 10
