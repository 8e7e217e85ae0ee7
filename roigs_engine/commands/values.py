"""The values that options take, checked alike on the command line and in an options file.

Each is what argparse calls the option's `type`: called with the text of the command line; `of_json`
takes a value of an options file. Both raise ArgumentTypeError with the end of a line that begins
with the option's name.
"""

from __future__ import annotations

from argparse import ArgumentTypeError
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import ConfigError
from ..storage.urls import is_url

MOST = (1 << 31) - 1  # of counts: a larger one is a typing error


@dataclass(frozen=True, kw_only=True)
class Number:
    """An integer or a number in a range.

    Attributes:
        low, high: the range; both belong to it.
        integer: whether it must be an integer.
        above: `low` does not belong to the range.
        zero: 0 is allowed too, though it is below the range.
    """

    low: float
    high: float
    integer: bool = False
    above: bool = False
    zero: bool = False

    def __call__(self, text: str) -> int | float:
        """The value of a text."""
        try:
            value: int | float | None = int(text) if self.integer else float(text)
        except ValueError:
            value = None
        return self._in_range(value, text)

    def of_json(self, value: Any) -> int | float:
        """The value of an options file."""
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


def integer(low: int, high: int = MOST, *, zero: bool = False) -> Number:
    """Integers from `low` to `high`, and 0 if `zero`."""
    return Number(low=low, high=high, integer=True, zero=zero)


class Name:
    """Text that is not blank."""

    def __call__(self, text: str) -> Any:
        """The text."""
        return self.of_json(text)

    def of_json(self, value: Any) -> Any:
        """The text of an options file."""
        if not isinstance(value, str) or "\0" in value:
            raise ArgumentTypeError(f"{shown(value)} is not a string")
        if not value.strip():
            raise ArgumentTypeError("it is empty")
        return value


class PathName(Name):
    """A path; a blank one would stand for the working directory."""

    def of_json(self, value: Any) -> Path:
        """The path of an options file."""
        text = super().of_json(value)
        if is_url(text):
            raise ArgumentTypeError(f"{shown(text)} is an address; only `batch` takes one")
        return Path(text)


NAME, PATH = Name(), PathName()


def named_file(option: str, text: str, form: str) -> tuple[str, Path]:
    """Name and path of an option's value such as `NAME=FILE`.

    Args:
        option: the option's name.
        text: its value.
        form: how it is written, for the message.

    Raises:
        ConfigError: the name or the path is missing.
    """
    name, separator, path = text.partition("=")
    if not separator or not name.strip():
        raise ConfigError(f"{option} {shown(text)} has no name.", f"Write {form}.")
    if not path.strip():
        raise ConfigError(f"{option} {shown(text)} has no file.", f"Write {form}.")
    return name, Path(path)


def shown(value: object) -> str:
    """The value for a message, on one line and not too long."""
    try:
        return f"{value!r:.60}"
    except ValueError:  # an integer of thousands of digits
        return "a number of thousands of digits"
