"""Text that a person may have written, decoded and read as JSON; numbers in sentences."""

from __future__ import annotations

import codecs
import hashlib
import json
from typing import Any

WIDE_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE, codecs.BOM_UTF32_BE)


def decode_text(data: bytes, *, replace: bool = False) -> str:
    """UTF-8 text, with or without a byte order mark, which some editors write.

    Args:
        data: the file's bytes.
        replace: bytes that are no UTF-8 become U+FFFD; else they are an error.

    Raises:
        ValueError: the text has another encoding; the message says which, if that is known.
    """
    # UTF-16 without a mark: each ASCII character brings a zero byte.
    if data.startswith(WIDE_MARKS) or b"\0" in data[:2]:
        raise ValueError("it is UTF-16 text; save it as UTF-8")
    try:
        return data.decode("utf-8-sig", errors="replace" if replace else "strict")
    except UnicodeDecodeError as error:
        raise ValueError("it is not UTF-8 text; save it as UTF-8") from error


def parse_json(data: bytes) -> Any:
    """The JSON value of a file's bytes.

    Raises:
        ValueError: it is none; the message says where or why.
    """
    text = decode_text(data)
    if not text.strip():
        raise ValueError("it is empty")
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        raise
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except ValueError as error:  # Python's limit for text that becomes an integer
        raise ValueError("it has a number of thousands of digits") from error


def counted(count: int, noun: str) -> str:
    """'1 photo', '2 photos', '12,345 photos'."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def in_gb(size: int) -> str:
    """A number of bytes for a message."""
    return f"{size / 1e9:.1f} GB"


def json_digest(value: Any) -> str:
    """SHA-256 of a JSON value, in hexadecimal digits; the order of keys does not matter."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
