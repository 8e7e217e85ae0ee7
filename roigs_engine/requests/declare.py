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
"""Options that an options file may not give: where to connect, and where to write.

The file may be somebody else's, and a cluster runs programs on the computer that connects to it.
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

    kind: Kind  # of its values
    help: str  # a phrase; `{default}` stands for the default
    name: str = ""  # of the field, and the key in an options file
    default: Any = None  # if it is not given
    required: bool = False  # whether it must be given
    heading: str = ""  # of its group in the help
    flags: tuple[str, ...] | None = None  # the usual one first; empty: it is given by its place
    repeat: bool = False  # whether it may be given several times; the field is a tuple
    several: bool = False  # whether several values may follow it; the field is a tuple
    excludes: str = ""
    decides: bool = True  # whether it decides results, so that a run folder keeps it
    hidden: str = ""
    label: str = ""  # its name in Blender's panel; empty: it is not there
    tooltip: str = ""  # its description there

    @property
    def many(self) -> bool:
        """Whether the field is a tuple."""
        return self.repeat or self.several

    @property
    def usage(self) -> str:
        """Its name for messages: the flag, or what stands for a value that is given by place."""
        return self.flags[0] if self.flags else self.kind.metavar or self.name

    def text(self) -> str:
        """The help with the default in it."""
        return self.help.replace("{default}", f"{self.default}")

    def checked(self, value: Any, where: str) -> Any:
        """A value of JSON, TOML or Python, converted; arrays and numbers of numpy are Python's.

        ConfigError: it does not fit; the message says `where` it stands.
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
    """A field of a request; `facts` are those of `Option`."""
    if facts.get("repeat") or facts.get("several"):
        default = default or ()
    if facts.get("required"):
        default = MISSING
    declared = Option(kind=kind, help=text, **facts)
    return field(default=default, metadata={OPTION: declared})


def argument(kind: Kind, text: str) -> Any:
    """A field of a request that must be given, on the command line by its place."""
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
        """Args: heading: of the options that this class declares, in the help."""
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
        """A request of the values by name that it has; others are left out."""
        known = options_of(cls)
        return cls(**{name: v for name, v in ({**values, **more}).items() if name in known})


def options_of(request: type[Request]) -> dict[str, Option]:
    """The options of a request by name: those of its groups in their order, then its own."""
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
    """Raise ConfigError if two of the given options exclude one another."""
    taken: dict[str, str] = {}
    for name, known in options_of(request).items():
        if known.excludes and given.get(name) not in (None, False, ()):
            other = taken.setdefault(known.excludes, name)
            if other != name:
                raise ConfigError(f"{where} has both '{other}' and '{name}'.", "Remove one.")


def settings_of(request: Request) -> dict[str, Any]:
    """The options that decide the results, as an options file has them; paths are absolute."""
    found = {}
    for name, known in options_of(type(request)).items():
        value = getattr(request, name)
        unset = value is None or value == () or (value is False and known.default is False)
        if known.decides and not unset:
            found[name] = plain(value)
    return found


def plain(value: Any) -> Any:
    """A value as JSON has it: an absolute path as text, a tuple as a list."""
    if isinstance(value, Path):
        return os.path.abspath(value)
    return list(value) if isinstance(value, tuple) else value


def read_options(path: Path, request: type[Request], given: Mapping[str, Any]) -> dict[str, Any]:
    """The values of an options file by name, without those that exclude one of `given`.

    Args:
        path: of the JSON file.
        request: whose options it may have.
        given: options that win over the file.

    Raises:
        ConfigError: the file cannot be read, has no scene, has an unknown key, one twice or one of
            `NOT_IN_FILES`, has two options that exclude one another, or a value does not fit.
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
        if value is not None:  # null: as if the key were missing
            values[name] = known[name].checked(value, f"'{key}' in {path}")
    refuse_both(request, values, f"The options file {path}")
    taken = {known[name].excludes for name in given if name in known} - {""}
    return {name: v for name, v in values.items() if known[name].excludes not in taken}
