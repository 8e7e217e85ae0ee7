"""Runs a part whose run folder is on a store: copies its inputs here, publishes its results.

The engine itself works in folders of this machine, as always.
"""

from __future__ import annotations

import errno
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ..context import Context
from ..errors import EngineError, Stopped
from ..formats.events import Record
from ..formats.files import write_json
from ..formats.run_files import BATCH_OUTPUTS, BATCH_ROWS, CHECKPOINT
from ..formats.text import first_line
from ..requests.values import is_url
from ..storage.commits import StoredRun, published_files
from ..storage.lease import Lease, LeaseTakenError
from ..storage.mirror import SCENES, mirror
from ..storage.quota import claim, enforce_quota, keep, limit
from ..storage.urls import StoreError, file_system, folder_of
from .engine_process import DONE, FAILED, LOST, STOPPED, Outcome, run_engine
from .parts import WHOLE, Part, Staging

RUNS = "runs"
PUBLISH_SECONDS = 60.0  # between two checks for new checkpoints
INPUTS = ("scene", "rois", "images", "masks", "object_masks", "selection")


def stored_run(url: str, run: str, should_stop: Callable[[], bool] = lambda: False) -> StoredRun:
    """A run folder of a batch on a store; ConfigError if the address cannot be used."""
    found, place = file_system(url, should_stop, own=True)
    return StoredRun(found, f"{place}/{run}")


def local_options(options: dict[str, Any], context: Context) -> dict[str, Any]:
    """Copy the inputs at addresses, and return options with the copies' paths.

    ConfigError: one cannot be read.
    """
    found = dict(options)
    for key in INPUTS:
        value = str(found.get(key))
        if is_url(value):
            folder, name = _folder_and_file(value)
            found[key] = str(mirror(folder, context) / name)
    return found


def _folder_and_file(url: str) -> tuple[str, str]:
    """The folder to copy for an address, and the file in it; empty: the folder itself."""
    folder, _, name = url.rstrip("/").rpartition("/")
    return (folder, name) if name.lower().endswith(".json") else (url, "")


def run_part(
    part: Part, threads: int, emit: Callable[[Record], None], should_stop: Callable[[], bool]
) -> Outcome:
    """Run a part to its end, on `threads` if its command has that option; see `run_engine`."""
    argv = [*part.argv, *(["--threads", str(threads)] if part.argv[0] == "run" else [])]
    if part.staging is None:
        return run_engine(argv, emit, should_stop)
    context = Context(should_stop=should_stop)
    try:
        found, _ = file_system(part.staging.url, should_stop, own=True)
        run = stored_run(part.staging.url, part.scene, should_stop)
        gone = ": waits for a minute, in case its previous engine is gone."

        def waits() -> None:
            emit({"event": "message", "text": gone})

        with Lease(found, run.lease_folder(part.name), should_stop, waits=waits) as lease:
            return _leased(argv, part, part.staging, run, lease, emit, context)
    except LeaseTakenError:
        if should_stop():
            return Outcome(state=STOPPED)
        return Outcome(state=LOST, reason="Another engine is at work on it.")
    except Stopped:
        return Outcome(state=STOPPED)
    except StoreError as error:  # a retry may help, unless a disk is full
        full = getattr(error.__cause__, "errno", None) == errno.ENOSPC
        return Outcome(state=FAILED if full else LOST, reason=str(error))
    except EngineError as error:
        return Outcome(state=FAILED, reason=str(error))
    except OSError as error:
        return Outcome(state=FAILED, reason=f"{error.strerror or error}.")
    except Exception as error:  # otherwise the batch would wait for it forever
        return Outcome(state=LOST, reason=f"{first_line(error):.200}")


def _leased(
    argv: list[str],
    part: Part,
    staging: Staging,
    run: StoredRun,
    lease: Lease,
    emit: Callable[[Record], None],
    context: Context,
) -> Outcome:
    limit()
    home = folder_of(staging.url, RUNS)
    folder = home / part.scene
    claim(context, folder, home / BATCH_ROWS, home / BATCH_OUTPUTS)
    write_json(home / BATCH_ROWS / f"{part.scene}.json", local_options(staging.options, context))
    run.fetch(folder)
    words = [word.replace(staging.base, str(home)) for word in argv]
    with _at_work(run, folder, part.name, staging, lease):
        ended = run_engine(words, emit, lambda: context.should_stop() or not lease.is_held())
    if not lease.is_held():
        return Outcome(state=LOST, reason="Another engine took it over.")
    if words[0] == "convert":  # writes beside the run folders
        out = Path(words[-1])
        if ended.state == DONE:
            run.put_beside(out, out.relative_to(home).as_posix())
            out.unlink()
    elif ended.state in (DONE, STOPPED):
        run.publish(folder, part.name, last=part.name == WHOLE and ended.state == DONE)
    enforce_quota()
    return ended


@contextmanager
def _at_work(
    run: StoredRun, folder: Path, part: str, staging: Staging, lease: Lease
) -> Iterator[None]:
    """Publish checkpoints while the engine works, so that another machine can resume.

    Also marks the copies that the engine uses as in use.
    """
    ended = threading.Event()

    def work() -> None:
        known: dict[Path, int] = {}
        while not ended.wait(PUBLISH_SECONDS):
            keep(folder)
            for url in filter(is_url, (str(staging.options.get(key)) for key in INPUTS)):
                keep(folder_of(_folder_and_file(url)[0], SCENES))
            # With a checkpoint, publish all files: without its manifest, no run resumes.
            with suppress(Exception):  # the end of the part tries again, and reports errors
                now = {path: path.stat().st_mtime_ns for path in folder.rglob(CHECKPOINT)}
                if now != known and now and lease.is_held():
                    names = published_files(folder)
                    run.publish(folder, f"{part} checkpoint", last=False, names=names)
                    known = now

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
