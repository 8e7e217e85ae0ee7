"""Options files: a command's options as JSON, checked as strictly as on the command line."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..errors import ConfigError
from ..formats.files import read_json
from .values import NAME, Name, Number, shown

NOT_KEYS = {"help", "events"}  # options that an options file must not set
# Of a parsed command line: what decides no result, and what is no option.
NO_SETTINGS = {
    *("command", "events", "options_given", "options_file", "run_dir", "update", "dry_run"),
    *("compare", "part", "cluster", "preview_seconds", "image_cache", "threads", "device"),
}


def with_options_file(
    parser: argparse.ArgumentParser,
    parsers: Mapping[str, argparse.ArgumentParser],
    argv: Sequence[str],
) -> argparse.Namespace:
    """The parsed command line; a scene that is an options file gives what it leaves out.

    The command line wins. Options that are required may be in the file.

    Args:
        parser: of the whole command line.
        parsers: its parser of each command.
        argv: the command line.

    Raises:
        ConfigError: the command line does not fit, the file cannot be read, a key is unknown or
            there twice, or a value does not fit its option.
    """
    required = [a for c in parsers.values() for a in c._actions if a.required and a.option_strings]
    for action in required:
        action.required = False
    first = argparse.Namespace()
    with suppress(ConfigError):  # said below, with all that is missing
        first = parser.parse_args(argv)
    for action in required:
        action.required = True
    path = getattr(first, "scene", None)
    if not isinstance(path, Path) or path.suffix.lower() != ".json" or first.command == "render":
        return parser.parse_args(argv)
    command = parsers[first.command]
    values = _checked(path, _read(path), command, first)
    scene = values.pop("scene")
    for action in required:
        action.required = not values.get(action.dest)
    command.set_defaults(**values)
    args = parser.parse_args(argv)
    args.scene, args.options_file = scene, path
    return args


def settings(args: argparse.Namespace) -> dict[str, Any]:
    """The options that decide the results, as an options file has them; paths are absolute."""
    given = {name: value for name, value in vars(args).items() if name not in NO_SETTINGS}
    return {
        name: os.path.abspath(value) if isinstance(value, Path) else value
        for name, value in given.items()
        if value is not None and value != []
    }


def _read(path: Path) -> dict[str, Any]:
    """The object in an options file, which has a scene."""
    record = read_json(path, ConfigError, "docs/files.md describes options files.")
    if not isinstance(record, dict) or not isinstance(record.get("scene"), str):
        raise ConfigError(
            f"The options file {path} has no scene.", 'Add the key "scene": "FOLDER".'
        )
    return record


def _checked(
    path: Path,
    record: dict[str, Any],
    command: argparse.ArgumentParser,
    args: argparse.Namespace,
) -> dict[str, Any]:
    """The values of the file's options by name, without those that exclude one of `args`."""
    options = {action.dest: action for action in command._actions}
    keys: dict[str, str] = {}
    values: dict[str, Any] = {}
    for key, value in record.items():
        name = key.replace("-", "_")
        if name not in options or name in NOT_KEYS:
            known = ", ".join(sorted(set(options) - NOT_KEYS))
            raise ConfigError(
                f"The options file {path} has an unknown key '{key:.60}'.",
                f"The known keys are: {known}.",
            )
        if keys.setdefault(name, key) != key:
            raise ConfigError(
                f"The options file {path} has both '{keys[name]}' and '{key}', which are one key.",
                "Remove one.",
            )
        if value is not None:  # null: as if the key were missing
            values[name] = typed(options[name], value, f"'{key}' in {path}")
    for group in command._mutually_exclusive_groups:
        names = [action.dest for action in group._group_actions]
        if len(both := [name for name in names if name in values]) > 1:
            raise ConfigError(
                f"The options file {path} has both '{both[0]}' and '{both[1]}'.", "Remove one."
            )
        if any(getattr(args, name) != command.get_default(name) for name in names):
            values = {key: value for key, value in values.items() if key not in names}
    return values


def typed(option: argparse.Action, value: Any, where: str) -> Any:
    """A value of a file, converted as the option would parse it; ConfigError if it does not fit.

    Args:
        option: of a command.
        value: JSON, or of TOML.
        where: the value stands, for the message.
    """
    if isinstance(option, argparse._AppendAction) or option.nargs == "*":
        items = value if isinstance(value, list) else [value]
        return [_one(option, item, where) for item in items]
    return _one(option, value, where)


def _one(option: argparse.Action, value: Any, where: str) -> Any:
    """One value of an option: an integer, a number, a string, or true or false."""
    try:
        if option.nargs == 0:
            if not isinstance(value, bool):
                raise argparse.ArgumentTypeError(f"{shown(value)} is not true or false")
            return value
        typed = option.type if isinstance(option.type, (Number, Name)) else NAME
        found = typed.of_json(value)
    except argparse.ArgumentTypeError as error:
        raise ConfigError(f"{where}: {error}.", f"See --help for '{option.dest}'.") from error
    if option.choices is not None and found not in option.choices:
        allowed = ", ".join(str(choice) for choice in option.choices)
        raise ConfigError(f"{where} is {shown(value)}.", f"Use one of {allowed}.")
    return found
