"""Kinds of option values, with the same checks on the command line, in files and in Python.

A kind converts the text of a command line when it is called; `of_json` takes a value of JSON, TOML
or Python. Both raise ArgumentTypeError. Its text completes a line that begins with the option's
name.
"""

from __future__ import annotations

import re
from argparse import ArgumentTypeError
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

MOST = (1 << 31) - 1  # largest count; a larger one is a typing error
FAR = 1e15  # limit of coordinates
AUTO = "auto"
SECRET = re.compile(r"//[^/@\s]*:(?!\d+/)[^@\s]*@|https?://[^/\s]*@|://.*\?", re.IGNORECASE)
"""Finds secrets in an address: user and password, a token, or a query, which may be a signature."""
HIDDEN = re.compile(r"(?<=://)[^@\s]*(?=@)|(?<=\?)[^\s\"'<>]+")
"""The parts of these that are not shown: user and password, and the query."""
SCHEME = re.compile(r"([a-z][a-z0-9+.-]+)://", re.IGNORECASE)
LONGEST = 2000
"""Most letters of an address, or of a text that is searched for one; the search is quadratic."""
ALMOST = re.compile(r"[a-z][a-z0-9+.-]+:|::", re.IGNORECASE)
"""Matches the beginning of addresses without `://`; a single letter is a drive on Windows."""


@dataclass(frozen=True, kw_only=True)
class Number:
    """An integer or a number in a range."""

    low: float  # `low` to `high`, inclusive
    high: float
    integer: bool = False  # whether it must be an integer
    above: bool = False  # whether `low` itself is excluded
    zero: bool = False  # whether 0 is also allowed, below the range
    metavar: str = "N"  # placeholder for the value in the help

    def __call__(self, text: str) -> Any:
        try:
            value: int | float | None = int(text) if self.integer else float(text)
        except ValueError:
            value = None
        return self._in_range(value, text)

    def of_json(self, value: Any) -> Any:
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        found: int | float | None = value if number else None
        if self.integer and isinstance(found, float):
            # Some programs write the integer 640 as 640.0.
            found = int(found) if found.is_integer() else None
        return self._in_range(found, value)

    def _in_range(self, value: int | float | None, given: object) -> int | float:
        if value is None or not self._contains(value):
            raise ArgumentTypeError(f"{shown(given if value is None else value)} is not {self}")
        return value if self.integer else float(value)

    def _contains(self, value: int | float) -> bool:
        if self.zero and value == 0:
            return True
        return self.low <= value <= self.high and not (self.above and value == self.low)

    def __str__(self) -> str:
        kind = "an integer" if self.integer else "a number"
        span = f"above {self.low:,} up to" if self.above else f"from {self.low:,} to"
        return f"{'0 or ' if self.zero else ''}{kind} {span} {self.high:,}"


def integer(low: int, high: int = MOST, *, zero: bool = False, metavar: str = "N") -> Number:
    """Integers from `low` to `high`, and 0 if `zero`."""
    return Number(low=low, high=high, integer=True, zero=zero, metavar=metavar)


@dataclass(frozen=True, kw_only=True)
class AutoOr(Number):
    """`auto`, or an integer in a range."""

    integer: bool = True

    def __call__(self, text: str) -> Any:
        return AUTO if text == AUTO else super().__call__(text)

    def of_json(self, value: Any) -> Any:
        return AUTO if value == AUTO else super().of_json(value)

    def __str__(self) -> str:
        return f"{AUTO}, or {integer(int(self.low), int(self.high))}"


class Name:
    """Text that is not blank; `metavar` stands for it in the help, or else the option's name."""

    def __init__(self, metavar: str = "") -> None:
        self.metavar = metavar

    def __call__(self, text: str) -> Any:
        return self.of_json(text)

    def of_json(self, value: Any) -> Any:
        if not isinstance(value, str) or "\0" in value:
            raise ArgumentTypeError(f"{shown(value)} is not a string")
        if not value.strip():
            raise ArgumentTypeError("it is empty")
        return value


class PathName(Name):
    """A path; a blank one would stand for the working directory."""

    def of_json(self, value: Any) -> Any:
        text = super().of_json(str(value) if isinstance(value, Path) else value)
        if is_url(text):
            refuse_secret(text)
            raise ArgumentTypeError(f"{shown(text)} is an address; only `batch` takes one")
        return Path(text)


class PlaceName(PathName):
    """A path, or an address of a store, which stays text."""

    def of_json(self, value: Any) -> Any:
        if is_url(value):
            refuse_secret(value)
            return value
        if begins_as_url(value):
            raise ArgumentTypeError(
                "it looks like an address without ://; for a folder of this name, write ./NAME"
            )
        return super().of_json(value)


class Place(Name):
    """Three numbers: a text with commas between them, or a list."""

    def of_json(self, value: Any) -> Any:
        parts = super().of_json(value).split(",") if isinstance(value, str) else value
        try:
            numbers = tuple(float(part) for part in parts)
        except (TypeError, ValueError):
            numbers = ()
        if len(numbers) != 3 or not all(abs(number) < FAR for number in numbers):
            raise ArgumentTypeError(f"{shown(value)} is not a point: x,y,z")
        return numbers


class Choice(Name):
    """One of several words."""

    def __init__(self, words: tuple[str, ...]) -> None:
        super().__init__()
        self.words = words

    def of_json(self, value: Any) -> Any:
        if super().of_json(value) not in self.words:
            raise ArgumentTypeError(f"{shown(value)} is not one of {', '.join(self.words)}")
        return value


class NamedChoice(Name):
    """One of several words, of which the last may have a name behind it: WORD:NAME."""

    def __init__(self, words: tuple[str, ...]) -> None:
        super().__init__(f"{'|'.join(words)}[:NAME]")
        self._words = words

    def of_json(self, value: Any) -> Any:
        word, _, name = str(super().of_json(value)).partition(":")
        if value not in self._words and not (word == self._words[-1] and name.strip()):
            raise ArgumentTypeError(
                f"{shown(value)} is not one of {', '.join(self._words)}, {self._words[-1]}:NAME"
            )
        return value


@dataclass(frozen=True, kw_only=True)
class Flag:
    """True or false; on the command line, the option's name alone is true."""

    metavar: ClassVar[str] = ""

    def of_json(self, value: Any) -> bool:
        if not isinstance(value, bool):
            raise ArgumentTypeError(f"{shown(value)} is not true or false")
        return value


Kind = Number | Name | Flag
NAME, FLAG = Name("NAME"), Flag()
PATH, DIR, FILE = PathName(), PathName("DIR"), PathName("FILE")


def is_url(text: object) -> bool:
    """Whether a text is an address of a store, such as `s3://bucket/scans`."""
    return isinstance(text, str) and "://" in text


def begins_as_url(text: object) -> bool:
    """Whether a text is an address, or looks like one without `://`."""
    return is_url(text) or (isinstance(text, str) and ALMOST.match(text) is not None)


def refuse_secret(url: str) -> None:
    """Raise ArgumentTypeError if an address is too long, or has a password or key."""
    if len(url) > LONGEST:
        raise ArgumentTypeError(f"it is too long for an address ({len(url):,} letters)")
    if SECRET.search(url):
        raise ArgumentTypeError(
            "it has a password or key, which logs would show; use fsspec's configuration instead"
            " (docs/many.md, Storage)"
        )


def without_secrets(text: str) -> str:
    """Remove passwords and queries of addresses from a text; a long text is shortened."""
    if len(text) > LONGEST:
        words, space, last = text[:LONGEST].rpartition(" ")
        # An address that is cut off may contain a password.
        text = f"{words}{space}{'...' if '//' in last else last}"
    return HIDDEN.sub("...", text) if SECRET.search(text) else text


def shown(value: object) -> str:
    """Format a value for a message: on one line, shortened, without secrets."""
    try:
        return f"{without_secrets(repr(value)):.60}"
    except ValueError:  # an integer with thousands of digits
        return "a number of thousands of digits"
