"""Decodes text and JSON, also if written by hand; formats names and numbers for messages."""

from __future__ import annotations

import codecs
import hashlib
import json
import re
from collections import Counter
from collections.abc import Container, Sequence
from typing import Any

# Characters that move a terminal's cursor, end a line or reverse the order of letters.
CONTROLS = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
MARKDOWN = re.compile(r"[\\`*_\[\]<>|~]")
"""What a name may hold that Markdown or HTML would take as its own."""
MARGIN = 50
"""Levels of the call stack reserved for code that hashes or writes a parsed value."""
NAMED = 4  # most names listed in a sentence
UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
UTF32_MARKS = (codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)  # the first begins with one of UTF-16


class RepeatedKeyError(ValueError):
    """A JSON object has a key twice; one of the values would be lost."""


def decode_text(data: bytes, *, replace: bool = False) -> str:
    """Decode UTF-8 text, with or without a byte order mark (some editors write one).

    Args:
        data: the file's bytes.
        replace: bytes that are not UTF-8 become U+FFFD; otherwise they raise an error.

    Raises:
        ValueError: the text has another encoding; the message says which, if that is known.
    """
    head = data[:4]
    if head == bytes(4):
        raise ValueError("it begins with zero bytes, so it is damaged or no text")
    # Without a mark, each ASCII character adds one zero byte in UTF-16, and three in UTF-32.
    if head.startswith(UTF32_MARKS) or head.count(0) == 3:
        raise ValueError("it is UTF-32 text; save it as UTF-8")
    if head.startswith(UTF16_MARKS) or 0 in head[:2]:
        raise ValueError("it is UTF-16 text; save it as UTF-8")
    try:
        return data.decode("utf-8-sig", errors="replace" if replace else "strict")
    except UnicodeDecodeError as error:
        raise ValueError("it is not UTF-8 text; save it as UTF-8") from error


def parse_json(data: bytes) -> Any:
    """Parse the JSON value in a file's bytes.

    Raises:
        RepeatedKeyError: an object has a key twice.
        ValueError: they are not JSON; the message says where or why.
    """
    text = decode_text(data)
    if not text.strip():
        raise ValueError("it is empty")
    try:
        return _loaded(text)
    except (json.JSONDecodeError, RepeatedKeyError):
        raise
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except ValueError as error:  # Python limits the digits of an integer in text
        raise ValueError("it has a number of thousands of digits") from error


def _loaded(text: str, margin: int = MARGIN) -> Any:
    """Parse JSON `margin` calls deeper in the stack, so that callers can write or hash the value.

    RecursionError: it is nested too deeply.
    """
    if margin:
        return _loaded(text, margin - 1)
    return json.loads(text, object_pairs_hook=_object)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        twice, _ = Counter(key for key, _ in pairs).most_common(1)[0]
        raise RepeatedKeyError(f"it has the key '{twice:.60}' twice in one object")
    return found


def printable(text: str) -> str:
    """The text on one line, with escapes (`\\x1b`) in the place of control characters."""
    return CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def markdown_text(text: str) -> str:
    """The text on one line; names in it are no Markdown, and no HTML."""
    return MARKDOWN.sub(r"\\\g<0>", printable(" ".join(text.split())))


def plain_text(markdown: str) -> str:
    """The text of which `markdown_text` has made this."""
    return re.sub(rf"\\({MARKDOWN.pattern})", r"\1", markdown)


def first_line(error: Exception) -> str:
    """The message of a library's error, on one line; its type's name if it is empty."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def named(names: Sequence[str], most: int = NAMED) -> str:
    """The first `most` names, and the number of the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def counted(count: int, noun: str) -> str:
    """'1 photo', '2 photos', '12,345 photos'."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def duration(seconds: float) -> str:
    """'40 seconds', '12 minutes', '3.5 hours', '2.1 days'."""
    if seconds < 90:
        return counted(max(1, round(seconds)), "second")
    if seconds < 5400:
        return f"{seconds / 60:.0f} minutes"
    return f"{seconds / 3600:.1f} hours" if seconds < 48 * 3600 else f"{seconds / 86400:.1f} days"


def in_columns(rows: Sequence[Sequence[str]], left: Container[int]) -> list[str]:
    """The rows of a table as lines; columns in `left` are left-aligned, others right-aligned."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if column in left else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def in_gb(size: int) -> str:
    """A number of bytes in GB or MB, for a message."""
    return f"{size / 1e9:.1f} GB" if size >= 1e8 or not size else f"{max(1, size // 10**6)} MB"


def json_digest(value: Any) -> str:
    """SHA-256 of a JSON value, in hexadecimal digits; the order of keys does not matter."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
