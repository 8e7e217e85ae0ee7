"""Reads command lines as requests, with an argparse parser built from the declared options.

Options cannot be abbreviated: a new option must not change the meaning of an old abbreviation. An
option for one value cannot be given twice: argparse would silently drop the first.
"""

from __future__ import annotations

import argparse
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from .. import __version__
from ..errors import ConfigError
from ..requests.declare import Option, Request, options_of, read_options
from ..requests.values import Choice, Flag
from .table import COMMANDS, Command


class StoreOnce(argparse.Action):
    """Stores an option's value; an error if the command line gives the option twice."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        if hasattr(namespace, self.dest):
            raise argparse.ArgumentError(self, "it is given twice")
        setattr(namespace, self.dest, values)


class Parser(argparse.ArgumentParser):
    """Raises a ConfigError for wrong options; argparse would print the whole usage."""

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, **options)
        self.register("action", None, StoreOnce)  # argparse's default action
        self.needed: list[argparse.Action] = []

    def _parse_optional(self, arg_string: str) -> Any:
        """Parse as argparse, but treat unknown words such as `-y` and `-1,0,2` as values."""
        single = arg_string.startswith("-") and not arg_string.startswith("--")
        if single and arg_string not in self._option_string_actions:
            return None
        return super()._parse_optional(arg_string)

    def error(self, message: str) -> NoReturn:
        message = message.removeprefix("argument ")
        raise ConfigError(f"{message[:1].upper()}{message[1:]}.", f"See {self.prog} --help.")

    def format_help(self) -> str:
        """The help. It marks required options, although an options file may provide them, too."""
        for action in self.needed:
            action.required = True
        text = super().format_help()
        for action in self.needed:
            action.required = False
        return text


@functools.cache
def build_parser(only: str = "") -> tuple[Parser, dict[str, Parser]]:
    """The main parser, and the parser of each command by name.

    With `only`, the other commands get no options: declaring all takes longer than parsing.
    """
    parser = Parser(
        prog="python -m roigs_engine",
        description="Sharp boxed objects in 3D Gaussian Splatting scenes (ROI-GS).",
    )
    parser.add_argument("--version", action="version", version=__version__)
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    parsers = {}
    for name, command in COMMANDS.items():
        examples = [f"  {parser.prog} {name} {example}" for example in command.examples]
        parsers[name] = subparsers.add_parser(
            name,
            help=command.help,
            description=f"{command.help[0].upper()}{command.help[1:]}.",
            epilog="\n".join(["examples:", *examples]),
            formatter_class=argparse.RawDescriptionHelpFormatter,
            argument_default=argparse.SUPPRESS,
        )
        if only in ("", name):
            _add_options(parsers[name], command)
        parsers[name].add_argument(
            "--events",
            action="store_true",
            default=False,
            help="JSON lines on standard output; reads 'stop'",
        )
    return parser, parsers


def _add_options(parser: Parser, command: Command) -> None:
    groups: dict[str, argparse._ActionsContainer] = {"": parser}
    either: dict[str, argparse._ActionsContainer] = {}
    for option in options_of(command.request).values():
        if option.hidden == "line":
            continue
        if option.heading not in groups:
            groups[option.heading] = parser.add_argument_group(option.heading)
        place = groups[option.heading]
        if option.excludes:
            if option.excludes not in either:
                must = option.excludes.endswith("!")
                either[option.excludes] = place.add_mutually_exclusive_group(required=must)
            place = either[option.excludes]
        action = place.add_argument(*(option.flags or (option.name,)), **_facts(option))
        if option.required:
            action.required = False
            parser.needed.append(action)


def _facts(option: Option) -> dict[str, Any]:
    """The arguments of argparse's `add_argument` for an option."""
    facts: dict[str, Any] = {"help": option.text().replace("%", "%%"), "dest": option.name}
    if option.hidden:
        facts["help"] = argparse.SUPPRESS
    if not option.flags:
        del facts["dest"]
        facts |= {} if option.required else {"nargs": "?"}
    if option.kind.metavar:
        facts["metavar"] = option.kind.metavar
    if isinstance(option.kind, Flag):
        return facts | {"action": "store_true", "default": argparse.SUPPRESS}
    if isinstance(option.kind, Choice):
        facts["choices"] = option.kind.words
    else:
        facts["type"] = option.kind
    if option.several:
        facts["nargs"] = "*"
    return facts | ({"action": "append"} if option.repeat else {})


def parsed(argv: Sequence[str]) -> tuple[Command, Request]:
    """Parse a command line: its command and request. ConfigError: an option or value is wrong.

    If the scene is an options file, the file provides options that the command line omits.
    """
    parser, parsers = build_parser(next((word for word in argv if word in COMMANDS), ""))
    given = vars(parser.parse_args(argv))
    name = given.pop("command")
    del given["events"]
    command = COMMANDS[name]
    values = _with_file(command, given) if command.takes_file else given
    missing = [
        option.usage
        for option in options_of(command.request).values()
        if option.required and values.get(option.name) in (None, ())
    ]
    if missing:
        parsers[name].error(f"the following arguments are required: {', '.join(missing)}")
    return command, command.request(**values)


def _with_file(command: Command, given: dict[str, Any]) -> Mapping[str, Any]:
    """The values of the command line, and of the options file if its scene is one."""
    path = given.get("scene")
    if not isinstance(path, Path) or path.suffix.lower() != ".json":
        return given
    values = read_options(path, command.request, given)
    return {**values, **given, "scene": values["scene"], "options_file": path}
