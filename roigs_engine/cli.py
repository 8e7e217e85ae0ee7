"""The command line: chooses the command, prints errors, and sets the exit status.

Exit status: 0 done; 2 an `EngineError`, wrong options included (one line on standard error);
3 stopped on request, with a checkpoint written. `commands.process` adds 130 and 141.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, NoReturn

from . import __version__
from .commands import (
    batch,
    check_gpu,
    clean,
    compose,
    convert,
    cut,
    evaluate,
    export,
    floaters,
    inspect,
    levels,
    masks,
    reconstruct,
    refine_cameras,
    render,
    render_frames,
    run,
    run_cluster,
    select,
    train,
)
from .commands.console import Console
from .commands.options_file import with_options_file
from .commands.out_folder import refuse_run_files
from .commands.process import NO_MEMORY, check_address_space, more_memory
from .commands.stopping import INTERRUPTED, StopRequest
from .errors import ConfigError, EngineError, Stopped
from .formats.events import Done, Failed
from .machine import is_memory_full

COMMANDS: dict[str, ModuleType] = {
    "reconstruct": reconstruct,
    "inspect": inspect,
    "export": export,
    "refine-cameras": refine_cameras,
    "select": select,
    "train": train,
    "compose": compose,
    "convert": convert,
    "masks": masks,
    "cut": cut,
    "floaters": floaters,
    "levels": levels,
    "evaluate": evaluate,
    "render": render,
    "render-frames": render_frames,
    "run": run,
    "batch": batch,
    "clean": clean,
    "check-gpu": check_gpu,
}
WITH_TORCH = (
    "train",
    "run",
    "batch",
    "evaluate",
    "render",
    "render-frames",
    "compose",
    "convert",
    "masks",
    "cut",
    "floaters",
    "check-gpu",
)
# Bytes of addresses below which torch and its threads do not start, or only hang: all, and a core.
MIN_TORCH, MIN_TORCH_CORE = 1200 << 20, 100 << 20
STOPPED = 3


class StoreOnce(argparse.Action):
    """Stores an option's value; an error if the command line gives the option twice."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """Set the value."""
        given = vars(namespace).setdefault("options_given", set())
        if option_string is not None and self.dest in given:
            raise argparse.ArgumentError(self, "it is given twice")
        given.add(self.dest)
        setattr(namespace, self.dest, values)


class Parser(argparse.ArgumentParser):
    """Raises an `EngineError` for wrong options; argparse would print the whole usage.

    Options cannot be abbreviated: a new option must not change the meaning of an old abbreviation.
    An option for one value cannot be given twice: argparse would silently drop the first.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, **options)
        self.register("action", None, StoreOnce)  # argparse's default action

    def error(self, message: str) -> NoReturn:
        """Raise a ConfigError."""
        message = message.removeprefix("argument ")
        raise ConfigError(f"{message[:1].upper()}{message[1:]}.", f"See {self.prog} --help.")


def build_parser() -> tuple[Parser, dict[str, Parser]]:
    """The main parser, and the parser of each command by name."""
    parser = Parser(
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
            "--events", action="store_true", help="JSON lines on standard output; reads 'stop'"
        )
    return parser, commands


def main(argv: Sequence[str] | None = None, stop: StopRequest | None = None) -> int:
    """Run one command and return its exit status; `stop` is watched, and asked by signals."""
    argv = sys.argv[1:] if argv is None else list(argv)
    parser, commands = build_parser()
    console = Console(json_lines="--events" in argv, stop=stop)

    def work() -> int:
        args = with_options_file(parser, commands, argv)
        console.watch()
        console.context.check_cancelled()
        if args.command in WITH_TORCH:
            check_address_space(args.command, MIN_TORCH, MIN_TORCH_CORE)
        refuse_run_files(getattr(args, "out", None))
        command = run_cluster if run_cluster.is_asked(args) else COMMANDS[args.command]
        outputs = command.run(args, console)
        console.emit(Done(outputs=outputs))
        return 0

    name = next((word for word in argv if word in COMMANDS), parser.prog)
    return exit_status_of(work, console, name)


def exit_status_of(work: Callable[[], int], console: Console, name: str) -> int:
    """Do the work and return its exit status; an error becomes one line.

    Args:
        work: returns an exit status.
        console: receives the events.
        name: the work's name in messages.
    """
    try:
        return work()
    except EngineError as error:
        console.emit(Failed(message=error.message, hint=error.hint))
        return 2
    except ModuleNotFoundError as error:
        if (error.name or "").startswith(__package__):
            raise
        text = f"`{name}` needs {error.name}, which is not installed in {sys.executable}."
        console.emit(Failed(message=text, hint="Install it there, or use another Python."))
        return 2
    except (ImportError, OSError, MemoryError, RuntimeError, SystemError) as error:
        failed = _system_failure(error)
        if failed is None:
            raise
        console.emit(failed)
        return 2
    except Stopped:
        console.emit(Done(outputs={}, stopped=True))
        return STOPPED
    except KeyboardInterrupt:
        return INTERRUPTED
    finally:
        console.close_bar()


def _system_failure(error: Exception) -> Failed | None:
    """The message for a file or memory error that no command handled; None for other errors."""
    if is_memory_full(error):
        return Failed(message=NO_MEMORY, hint=more_memory())
    if isinstance(error, OSError) and error.filename is not None:
        name = f"{os.fsdecode(error.filename):.200}"
        return Failed(message=f"Cannot use {name!r} ({error.strerror}).", hint="Choose another.")
    return None
