"""A request file: a command's options as JSON, checked as strictly as on the command line."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import ConfigError
from ..formats.files import read_json

NOT_KEYS = {"help", "events"}  # what a command does with its output is not of the request


def with_options_file(
    parser: argparse.ArgumentParser,
    command: argparse.ArgumentParser,
    args: argparse.Namespace,
    argv: Sequence[str] | None,
) -> argparse.Namespace:
    """When the scene is a request file, its values become defaults; given options still win.

    Raises:
        ConfigError: a key is unknown, or a value is not what its option takes.
        RunFolderError: the file cannot be read.
    """
    path = getattr(args, "scene", None)
    if not isinstance(path, Path) or path.suffix.lower() != ".json" or args.command == "render":
        return args
    request = read_json(path)
    if not isinstance(request, dict) or not isinstance(request.get("scene"), str):
        raise ConfigError(f"The request {path} names no scene.", 'It needs "scene": "FOLDER".')
    options = {action.dest: action for action in command._actions}
    values: dict[str, Any] = {}
    for key, value in request.items():
        name = key.replace("-", "_")
        if name not in options or name in NOT_KEYS:
            known = ", ".join(sorted(set(options) - NOT_KEYS))
            raise ConfigError(
                f"The request {path} has an unknown key '{key:.60}'.", f"Known: {known}."
            )
        if value is not None:  # null: as if it were not there
            values[name] = _typed(options[name], value, f"'{key}' in {path}")
    for group in command._mutually_exclusive_groups:
        names = [action.dest for action in group._group_actions]
        if len(both := [name for name in names if name in values]) > 1:
            raise ConfigError(f"The request {path} has both '{both[0]}' and '{both[1]}'.")
        if any(getattr(args, name) != command.get_default(name) for name in names):
            values = {key: value for key, value in values.items() if key not in names}
    scene = values.pop("scene")
    command.set_defaults(**values)
    args = parser.parse_args(argv)
    args.scene = scene
    return args


def _typed(option: argparse.Action, value: Any, where: str) -> Any:
    """A request's value as the option would have parsed it."""
    if isinstance(option, argparse._AppendAction) or option.nargs == "*":
        items = value if isinstance(value, list) else [value]
        return [_one(option, item, where) for item in items]
    return _one(option, value, where)


def _one(option: argparse.Action, value: Any, where: str) -> Any:
    """One value of an option: a whole number, a number, a text, or true and false."""
    fits, kind = False, option.type or str
    if option.nargs == 0:
        fits, kind = isinstance(value, bool), bool
    elif kind in (int, float):
        # What is 640 to people is 640.0 to some programs.
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        fits = number and (kind is float or value == value // 1)
    else:
        fits = isinstance(value, str) and "\0" not in value
    try:
        typed = kind(value) if fits and callable(kind) else None
    except (OverflowError, ValueError):
        typed = None
    if typed is None:
        raise ConfigError(f"{where} is {_short(value)}, which it cannot be.")
    if option.choices is not None and typed not in option.choices:
        allowed = ", ".join(str(choice) for choice in option.choices)
        raise ConfigError(f"{where} is {_short(value)}.", f"Use one of {allowed}.")
    return typed


def _short(value: Any) -> str:
    """The value for a message."""
    try:
        return f"{value!r:.60}"
    except ValueError:  # an integer of thousands of digits
        return "a number of thousands of digits"
