"""The add-on's side of the event stream: whatever the engine's process writes, the panel lives."""

from __future__ import annotations

import io
import json
import tracemalloc
from typing import Any

import pytest
from hypothesis import example, given, seed
from hypothesis import strategies as st

from roigs_addon.engine.event_log import read_lines
from roigs_engine.formats.events import FIELDS, MAX_LINE, MAX_NUMBER, parse_event
from tests.fuzz.cases import SEED

ODD_NUMBERS = [float("nan"), float("inf"), 1e308, 2**31, -(10**400), 2**63, True]
LEAVES = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text()
    | st.sampled_from(ODD_NUMBERS)
)
VALUES = st.recursive(
    LEAVES, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=8
)
KEYS = st.sampled_from(sorted({key for keys in FIELDS.values() for key in keys})) | st.text()
RECORDS = st.builds(
    lambda name, rest: {**rest, "event": name},
    st.sampled_from(sorted(FIELDS)) | VALUES,
    st.dictionaries(KEYS, VALUES),
)


def assert_sound(event: dict[str, Any] | None) -> None:
    """It is none, or all it holds is what Blender's properties and paths take."""
    if event is None:
        return
    fields = FIELDS[event["event"]]
    assert set(event) <= {"event", *fields}
    for key, value in event.items():
        kind = fields.get(key, str)
        assert type(value) is kind, key
        if kind in (int, float):
            assert abs(value) < MAX_NUMBER
        if kind is str and key != "path":
            assert value.isprintable() and value.encode("utf-8") is not None
        if kind is dict:
            assert all(isinstance(path, str) for path in value.values())


@seed(SEED)
@given(RECORDS)
@example({"event": "message", "text": "\ud800\0\n\x1b[2J"})
@example({"event": "progress", "step": float("nan"), "loss": 10**400})
def test_events_of_any_content(record: dict[str, Any]) -> None:
    try:
        line = json.dumps(record)
    except ValueError:  # an integer of more digits than Python writes
        return
    assert_sound(parse_event(line))


@seed(SEED)
@given(st.binary(max_size=200) | st.text(max_size=200).map(lambda t: t.encode("utf-8", "replace")))
def test_lines_of_any_bytes(data: bytes) -> None:
    for line in read_lines(io.TextIOWrapper(io.BytesIO(data), encoding="utf-8", errors="replace")):
        assert_sound(parse_event(line))


@pytest.mark.parametrize("line", ["[" * 60_000, '{"a":' * 10_000, "9" * 60_000, '"' + "x" * 60_000])
def test_deep_and_long_lines(line: str) -> None:
    assert parse_event(line) is None


def test_a_line_of_any_length_takes_bounded_memory() -> None:
    """A huge line is cut; those before and after it arrive."""

    long = [b"x" * 65_536] * 1600  # 100 MiB
    parts = [b'{"event": "message", "text": "a"}\n', *long, b'\n{"event": "done"}\n']

    class Parts(io.RawIOBase):
        def readable(self) -> bool:
            return True

        def readinto(self, buffer: Any) -> int:
            if not parts:
                return 0
            part = parts.pop(0)
            taken = min(len(part), len(buffer))
            buffer[:taken] = part[:taken]
            if taken < len(part):
                parts.insert(0, part[taken:])
            return taken

    tracemalloc.start()
    stream = io.TextIOWrapper(io.BufferedReader(Parts()), encoding="utf-8", errors="replace")
    lines = list(read_lines(stream))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert [len(line) > MAX_LINE for line in lines] == [False, True, False]
    assert [event and event["event"] for event in map(parse_event, lines)] == [
        "message",
        None,
        "done",
    ]
    assert peak < 4 << 20
