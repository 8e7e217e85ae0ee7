"""Declares options as dataclass fields, and makes requests from checked values.

We tried tyro and jsonargparse instead. Both report a wrong value in several lines and accept an
option that is given twice; jsonargparse also accepts abbreviations. Adapters for their messages,
and the strict merge with an options file, were longer than this file.
"""

from __future__ import annotations

import os
from argparse import ArgumentTypeError
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Self

from ..errors import ConfigError
from ..formats.files import read_json
from .values import Kind

OPTION = "option"
NOT_IN_FILES = ("cluster", "run_dir", "out")
"""Options that an options file must not set: the cluster, and where to write.

The file may come from an untrusted person, and a cluster can run programs on a computer that
connects to it.
"""


@dataclass(frozen=True, kw_only=True)
class Option:
    """All that is known of an option.

    Attributes:
        excludes: options with the same word here exclude one another; one of those whose word ends
            in `!` must be given.
        hidden: `help`: the command line takes it, the help does not show it; `line`: only files and
            Python have it.
    """

    kind: Kind  # kind of the values
    help: str  # a phrase; `{default}` stands for the default
    name: str = ""  # name of the field, and key in an options file
    default: Any = None  # the value if it is not given
    required: bool = False  # whether it must be given
    heading: str = ""  # heading of its group in the help
    flags: tuple[str, ...] | None = None  # the usual one first; empty: a positional argument
    repeat: bool = False  # whether it may be given several times; the field is a tuple
    several: bool = False  # whether several values may follow it; the field is a tuple
    excludes: str = ""
    decides: bool = True  # whether it affects results, so that a run folder stores it
    hidden: str = ""
    label: str = ""  # name in Blender's panel; empty: not in the panel
    tooltip: str = ""  # description in the panel

    @property
    def many(self) -> bool:
        """Whether the field is a tuple."""
        return self.repeat or self.several

    @property
    def usage(self) -> str:
        """The option's name in messages: the flag, or the placeholder of a positional argument."""
        return self.flags[0] if self.flags else self.kind.metavar or self.name

    def text(self) -> str:
        """The help, with the default filled in."""
        return self.help.replace("{default}", f"{self.default}")

    def checked(self, value: Any, where: str) -> Any:
        """Convert a value from JSON, TOML or Python, also numpy's arrays and numbers.

        ConfigError: the value is invalid; `where` begins the message.
        """
        value = value.tolist() if hasattr(value, "tolist") else value
        try:
            if self.many:
                items = value if isinstance(value, (list, tuple)) else [value]
                return tuple(self.kind.of_json(item) for item in items)
            return self.kind.of_json(value)
        except ArgumentTypeError as error:
            raise ConfigError(f"{where}: {error}.", "Correct or remove it.") from error


def option(kind: Kind, text: str, default: Any = None, **facts: Any) -> Any:
    """Declare a field of a request; `facts` are other attributes of `Option`."""
    if facts.get("repeat") or facts.get("several"):
        default = default or ()
    if facts.get("required"):
        default = MISSING
    declared = Option(kind=kind, help=text, **facts)
    return field(default=default, metadata={OPTION: declared})


def argument(kind: Kind, text: str) -> Any:
    """Declare a required field of a request; on the command line, a positional argument."""
    return option(kind, text, required=True, flags=())


@dataclass(frozen=True, kw_only=True)
class Request:
    """The input of a command. Its values are checked when it is created.

    Lists become tuples and texts become paths, so that `Select(scene="garden", roi=["auto"])` is as
    good as the exact types. None is as good as no value.

    Attributes:
        options_file: the file that some of the values were read from; it must not be replaced.

    Raises:
        ConfigError: a value does not fit, is missing, or excludes another.
    """

    heading: ClassVar[str] = ""
    options_file: Path | None = None

    def __init_subclass__(cls, heading: str = "") -> None:
        """Args: heading: the heading in the help for options that this class declares."""
        cls.heading = heading

    def __post_init__(self) -> None:
        given = {}
        for name, known in options_of(type(self)).items():
            value = getattr(self, name)
            value = known.default if value is None else known.checked(value, f"'{name}'")
            if known.required and value in (None, ()):
                raise ConfigError(f"The request has no '{name}'.", "Give it a value.")
            object.__setattr__(self, name, value)
            if value != known.default:
                given[name] = value
        refuse_both(type(self), given, "The request")

    @classmethod
    def of(cls, values: Mapping[str, Any], **more: Any) -> Self:
        """Create a request from name -> value; names that it does not have are ignored."""
        known = options_of(cls)
        return cls(**{name: v for name, v in ({**values, **more}).items() if name in known})


def options_of(request: type[Request]) -> dict[str, Option]:
    """Name -> option of a request: first those of its groups, in order, then its own."""
    known: Any = request
    return _declared(known)


@cache
def _declared(request: Any) -> dict[str, Option]:
    found: dict[str, Option] = {}
    for part in (*request.__mro__[1:], request):
        fields = vars(part).get("__dataclass_fields__", {})
        for name in vars(part).get("__annotations__", {}):
            declared = fields[name].metadata.get(OPTION) if name in fields else None
            if declared is None:
                continue
            required = fields[name].default is MISSING
            usual = (f"--{name.replace('_', '-')}",)
            found[name] = replace(
                declared,
                name=name,
                flags=usual if declared.flags is None else declared.flags,
                required=required,
                default=None if required else fields[name].default,
                heading=vars(part).get("heading", ""),
            )
    return found


def refuse_both(request: type[Request], given: Mapping[str, Any], where: str) -> None:
    """Raise ConfigError if two of the given options exclude each other."""
    taken: dict[str, str] = {}
    for name, known in options_of(request).items():
        if known.excludes and given.get(name) not in (None, False, ()):
            other = taken.setdefault(known.excludes, name)
            if other != name:
                raise ConfigError(f"{where} has both '{other}' and '{name}'.", "Remove one.")


def settings_of(request: Request) -> dict[str, Any]:
    """The options that affect results, as in an options file, with absolute paths."""
    found = {}
    for name, known in options_of(type(request)).items():
        value = getattr(request, name)
        unset = value is None or value == () or (value is False and known.default is False)
        if known.decides and not unset:
            found[name] = plain(value)
    return found


def plain(value: Any) -> Any:
    """Convert a value for JSON: a path to absolute text, a tuple to a list."""
    if isinstance(value, Path):
        return os.path.abspath(value)
    return list(value) if isinstance(value, tuple) else value


def read_options(path: Path, request: type[Request], given: Mapping[str, Any]) -> dict[str, Any]:
    """Read name -> value of an options file, without options that exclude one of `given`.

    Args:
        path: the JSON file.
        request: the request that has the options.
        given: options that override the file.

    Raises:
        ConfigError: the file cannot be read, or has no scene. A key is unknown, repeated or in
            `NOT_IN_FILES`. Two options exclude each other, or a value is invalid.
    """
    record = read_json(path, ConfigError, "docs/files.md describes options files.")
    if not isinstance(record, dict) or not isinstance(record.get("scene"), str):
        raise ConfigError(
            f"The options file {path} has no scene.", 'Add the key "scene": "FOLDER".'
        )
    known = options_of(request)
    keys: dict[str, str] = {}
    values: dict[str, Any] = {}
    for key, value in record.items():
        name = key.replace("-", "_")
        if name not in known:
            raise ConfigError(
                f"The options file {path} has an unknown key '{key:.60}'.",
                f"The known keys are: {', '.join(sorted(known))}.",
            )
        if name in NOT_IN_FILES and value is not None:
            raise ConfigError(
                f"The options file {path} must not have the key '{key}'.",
                f"Remove it, and give {known[name].usage} on the command line.",
            )
        if keys.setdefault(name, key) != key:
            raise ConfigError(
                f"The options file {path} has both '{keys[name]}' and '{key}', which are one key.",
                "Remove one.",
            )
        if value is not None:  # null counts as a missing key
            values[name] = known[name].checked(value, f"'{key}' in {path}")
    refuse_both(request, values, f"The options file {path}")
    taken = {known[name].excludes for name in given if name in known} - {""}
    return {name: v for name, v in values.items() if known[name].excludes not in taken}
