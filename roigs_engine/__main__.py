"""`python -m roigs_engine COMMAND`: the engine's command line."""

from __future__ import annotations

import sys

if not sys.flags.safe_path:
    # `-m` puts the working folder first, where a file `numpy.py` may lie beside the photos.
    del sys.path[0]

import os
import signal

from . import TYPE_CHECKING

if TYPE_CHECKING:
    from .commands.stopping import StopRequest


def _main(stop: StopRequest) -> int:
    """The command line, imported once signals are watched: that takes a while."""
    from .cli import main

    return main(stop=stop)


if __name__ == "__main__":
    # Python's own answer to Ctrl-C, a traceback, would come out of the next import.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if os.name == "posix" and sys.getfilesystemencoding() != "utf-8":
        # Names are UTF-8 everywhere here; this locale could not write them. Begin again in UTF-8.
        os.execv(sys.executable, [sys.executable, "-X", "utf8", *sys.orig_argv[1:]])
    os.environ["PYTHONSAFEPATH"] = "1"  # for every process that this one starts
    from .commands.process import run_process

    run_process(_main)
