"""Text files as people's editors write them, and damaged ones."""

from __future__ import annotations

import codecs
import json
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from roigs_engine.errors import EngineError, RoiError
from roigs_engine.formats.files import read_json
from roigs_engine.formats.rois import read_rois
from roigs_engine.formats.text import (
    RepeatedKeyError,
    counted,
    decode_text,
    json_digest,
    parse_json,
    printable,
)

VALUE = {"name": "Büste", "x": [1.5, None]}
ENCODINGS = [f"utf-{width}{order}" for width in (16, 32) for order in ("", "-le", "-be")]
TEXT = json.dumps(VALUE, ensure_ascii=False)


def test_a_mark_at_the_start_is_no_error(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    for data in (TEXT.encode(), codecs.BOM_UTF8 + TEXT.encode()):
        path.write_bytes(data)
        assert read_json(path) == VALUE


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_wide_text_is_named(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "rois.json"
    path.write_bytes(TEXT.encode(encoding))
    name = encoding.upper()[:6]
    with pytest.raises(RoiError, match=rf"rois\.json is not JSON \(it is {name} text; save it as"):
        read_rois(path)
    with pytest.raises(ValueError, match=name):
        decode_text(TEXT.encode(encoding), replace=True)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (TEXT.encode("latin-1"), "not UTF-8 text; save it as UTF-8"),
        (b"", "it is empty"),
        (bytes(64), "begins with zero bytes"),
        (codecs.BOM_UTF8 + b" \n", "it is empty"),
        (b"[" * 200_000, "nested too deeply"),
        (b'{"a": ' * 100_000, "nested too deeply"),
        (b"1" * 9000, "thousands of digits"),
        (b'{"a": 1,}', "line 1 column"),
        (TEXT.encode()[:9], "line 1 column"),
    ],
)
def test_damaged_files_say_why_and_what_to_do(data: bytes, text: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=text):
        parse_json(data)
    path = tmp_path / "a.json"
    path.write_bytes(data)
    with pytest.raises(EngineError, match=text) as caught:
        read_json(path)
    assert caught.value.hint and str(path) in caught.value.message
    with pytest.raises(EngineError, match="Cannot read") as caught:
        read_json(tmp_path / "none.json")
    assert caught.value.hint


@pytest.mark.parametrize(
    "text",
    [
        '{"x": 1, "roi": 2, "roi": 2}',
        '[{"a": {"b": [{"roi": null, "roi": {"roi": 1}}]}}]',
        '{"roi": 1, "r\\u006fi": 2}',
    ],
)
def test_a_key_that_is_there_twice_is_named(text: str, tmp_path: Path) -> None:
    with pytest.raises(RepeatedKeyError, match="the key 'roi' twice"):
        parse_json(text.encode())
    path = tmp_path / "a.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RoiError, match=r"a\.json is ambiguous: .* 'roi' twice") as caught:
        read_json(path, RoiError)
    assert caught.value.hint == "Keep one of the two."


def test_one_key_in_two_objects_is_fine() -> None:
    assert parse_json(b'[{"a": 1}, {"a": {"a": 2}}]') == [{"a": 1}, {"a": {"a": 2}}]


def test_control_characters_become_escapes() -> None:
    assert printable("a\x1b[2J\r\n\t\0\x7f\x9b\u2028\u202e") == (
        r"a\x1b[2J\r\n\t\x00\x7f\x9b\u2028\u202e"
    )
    plain = "Größe 模型 \u00a0 🙂 \\ \udce9 e\u0301 \u200d"
    assert printable(plain) == plain


def test_counts_in_sentences() -> None:
    assert [counted(n, "photo") for n in (0, 1, 12_345)] == ["0 photos", "1 photo", "12,345 photos"]


def test_what_is_read_can_be_hashed_by_whoever_is_deeper_in_calls() -> None:
    """However deep it is nested: else one of some hundred commits ended a batch."""

    def hashed(value: Any, calls: int) -> str:
        return hashed(value, calls - 1) if calls else json_digest(value)

    depth, read = sys.getrecursionlimit(), 0
    for deep in range(depth - 300, depth):
        with suppress(ValueError):
            hashed(parse_json(b"[" * deep + b"]" * deep), 20)
            read += 1
    assert read or sys.version_info >= (3, 12)
