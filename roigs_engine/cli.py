"""The command line: which command, what becomes of errors, and the exit status.

Exit status: 0 done, 2 an `EngineError` (one line on standard error), 3 stopped on request with a
checkpoint written, 130 interrupted at once.
"""

from __future__ import annotations

import argparse
import atexit
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

from . import __version__
from .commands import compose, evaluate, export, inspect, render, run, select, train
from .commands.console import Console
from .errors import ConfigError, EngineError, Stopped
from .events import Done, Failed
from .files import read_json

COMMANDS: dict[str, ModuleType] = {
    "inspect": inspect,
    "export": export,
    "select": select,
    "train": train,
    "compose": compose,
    "evaluate": evaluate,
    "render": render,
    "run": run,
}
STOPPED = 3


def build_parser() -> tuple[argparse.ArgumentParser, dict[str, argparse.ArgumentParser]]:
    """The parser, and that of each command."""
    parser = argparse.ArgumentParser(
        prog="python -m roigs_engine",
        description="Sharp boxed objects in 3D Gaussian Splatting scenes (ROI-GS).",
    )
    parser.add_argument("--version", action="version", version=__version__)
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    commands = {}
    for name, module in COMMANDS.items():
        commands[name] = subparsers.add_parser(
            name,
            help=module.HELP,
            description=f"{module.HELP[0].upper()}{module.HELP[1:]}.",
            epilog=f"examples:\n{module.EXAMPLES}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(commands[name])
        commands[name].add_argument(
            "--events", action="store_true", help="JSON lines on standard output; reads «stop»"
        )
    return parser, commands


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status."""
    parser, commands = build_parser()
    args = parser.parse_args(argv)
    console = Console(json_lines=args.events)
    try:
        args = _with_request_file(parser, commands[args.command], args, argv)
        console.watch()
        outputs = COMMANDS[args.command].run(args, console)
        console.emit(Done(outputs=outputs))
        return 0
    except EngineError as error:
        console.emit(Failed(message=error.message, hint=error.hint))
        return 2
    except ModuleNotFoundError as error:
        if (error.name or "").startswith(__package__):
            raise
        text = f"`{args.command}` needs {error.name}, which this Python lacks ({sys.executable})."
        console.emit(Failed(message=text, hint="Install it there, or use another Python."))
        return 2
    except MemoryError:
        text = "The machine's memory is full."
        console.emit(Failed(message=text, hint="Use a smaller --max-side or --image-cache."))
        return 2
    except Stopped:
        console.emit(Done(outputs={}, stopped=True))
        return STOPPED
    except KeyboardInterrupt:
        return 130
    finally:
        console.close_bar()


def _with_request_file(
    parser: argparse.ArgumentParser,
    command: argparse.ArgumentParser,
    args: argparse.Namespace,
    argv: Sequence[str] | None,
) -> argparse.Namespace:
    """When the scene is a request file, its values become defaults; given options still win."""
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
        if name not in options or name == "help":
            known = ", ".join(sorted(set(options) - {"help"}))
            raise ConfigError(f"The request {path} has an unknown key «{key}».", f"Known: {known}.")
        values[name] = _typed(options[name], value, f"«{key}» in {path}")
    scene = values.pop("scene")
    command.set_defaults(**values)
    args = parser.parse_args(argv)
    args.scene = scene
    return args


def _typed(option: argparse.Action, value: Any, where: str) -> Any:
    """A request's value as the option would have parsed it."""
    try:
        if isinstance(value, list):
            return [option.type(item) if callable(option.type) else item for item in value]
        typed = option.type(value) if callable(option.type) and value is not None else value
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{where} is {value!r}, which it cannot be.") from error
    if option.choices is not None and typed not in option.choices:
        allowed = ", ".join(str(choice) for choice in option.choices)
        raise ConfigError(f"{where} is {value!r}.", f"Use one of {allowed}.")
    return typed


def entry() -> None:
    """What `python -m roigs_engine` calls.

    The process ends at once: taking Python, torch and a large scene apart piece by piece takes most
    of a second, in which whoever asked for a stop waits.
    """
    status = main()
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # nobody reads it any more
            stream.flush()
    os._exit(status)
