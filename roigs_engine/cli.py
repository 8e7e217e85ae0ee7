"""Entry of the command line: makes a request, prints its result or a one-line error.

Exit status: 0 done; 2 an `EngineError`, including wrong options (one line on standard error); 3
stopped on request, with a checkpoint written. `commands.process` adds 130 and 141.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence

from .commands.console import Console
from .commands.parser import parsed
from .commands.process import check_address_space
from .commands.stopping import INTERRUPTED, StopRequest
from .commands.table import COMMANDS
from .errors import Stopped
from .formats.events import Done, Failed

# Bytes of addresses below which torch and its threads do not start, or only hang: all, and a core.
MIN_TORCH, MIN_TORCH_CORE = 1200 << 20, 100 << 20
STOPPED = 3


def main(argv: Sequence[str] | None = None, stop: StopRequest | None = None) -> int:
    """Run one command and return its exit status; `stop` is watched, and asked by signals."""
    argv = sys.argv[1:] if argv is None else list(argv)
    console = Console(json_lines="--events" in argv, stop=stop)
    name = next((word for word in argv if word in COMMANDS), "python -m roigs_engine")

    def work() -> int:
        command, request = parsed(argv)
        console.watch()
        context = console.context
        context.check_cancelled()
        if command.torch:
            check_address_space(name, MIN_TORCH, MIN_TORCH_CORE)
            os.getcwd()  # without one, torch's libraries end the process
        result = command.run(request, context, console.print)
        if result.text:
            console.print(result.text)
        if result.error is not None:
            raise result.error
        console.emit(Done(outputs=result.outputs))
        return 0

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
    except Stopped as stopped:
        console.resumes = stopped.resumes
        console.emit(Done(outputs={}, stopped=True))
        return STOPPED
    except KeyboardInterrupt:
        return INTERRUPTED
    except Exception as error:
        failed = _failure(error, name)
        if failed is None:
            raise
        console.emit(failed)
        return 2
    finally:
        console.close_bar()


def _failure(error: Exception, name: str) -> Failed | None:
    """The words for an error; None: it is a bug."""
    from .app.event_log import failure

    if isinstance(error, FileNotFoundError) and error.filename is None:
        try:
            os.getcwd()
        except FileNotFoundError:
            text = "The working folder was deleted."
            return Failed(message=text, hint="Change to another one.")
    if isinstance(error, ModuleNotFoundError) and not (error.name or "").startswith(__package__):
        text = f"`{name}` needs {error.name}, which is not installed in {sys.executable}."
        return Failed(message=text, hint="Install it there, or use another Python.")
    return failure(error)
