"""Batches with run folders or scenes on a store (docs/many.md, section Storage)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..batch.record import BatchRecord
from ..batch.staged import local_options, stored_run
from ..context import Context
from ..errors import ConfigError, EngineError, RunFolderError
from ..formats.files import own_folder
from ..formats.run_files import BATCH, CACHE, CROPS, MANIFEST, REPORT_DATA, REPORT_PAGE
from ..photos.contents import FILE as CONTENTS
from ..requests.values import is_url
from ..storage.commits import StoredRun
from ..storage.lease import Lease, LeaseTakenError
from ..storage.mirror import sign
from ..storage.quota import make_copy
from ..storage.urls import file_system, folder_of, refuse_lost, small_files
from .batch_table import Row, Wrong

BATCHES = "batches"
SHOWN = (MANIFEST, REPORT_DATA, REPORT_PAGE, f"{CACHE}/{CONTENTS}")
"""Files of a run that the page and the record of a batch need, besides its pictures."""


class Store:
    """The folder of a batch on a store (`url`), with a local copy of the files for its page."""

    def __init__(self, url: str, context: Context) -> None:
        """Open the store; ConfigError for a bad address, RunFolderError if the copy is a link."""
        refuse_lost(url)
        self.url = url
        self.folder = folder_of(url, BATCHES)
        self._should_stop = context.should_stop
        self._found, self._place = file_system(url, context.should_stop, own=True)
        make_copy(self.folder)  # before anything in it is locked, deleted or written
        self._there: set[str] = set()

    @contextmanager
    def held(self, context: Context) -> Iterator[None]:
        """Hold the lease of the only batch that works there; RunFolderError if another does."""

        def waits() -> None:
            context.info("Another batch was at work there: waiting for a minute, if it is gone.")

        place = f"{self._place}/.leases/batch"
        lease = Lease(self._found, place, context.should_stop, waits=waits)
        try:
            with lease:
                yield
        except LeaseTakenError as error:
            context.check_cancelled()
            raise RunFolderError(
                f"Another batch is at work in {self.url}.", "Wait for it, or stop it."
            ) from error

    def open(self, names: Iterable[str]) -> None:
        """Download the record of earlier batches, and the files of each run that it needs."""
        here = self.folder / BATCH
        here.unlink(missing_ok=True)
        listed = self._found.find(f"{self._place}/{BATCH}", detail=True)
        if small_files(listed):
            self._found.get_file(f"{self._place}/{BATCH}", str(here))
        for name in names:
            self.fetch(name)

    def file_of_others(self, names: Sequence[str], runs: Sequence[str]) -> str | None:
        """Return the first file there that a batch would replace; None if all are a batch's.

        Args:
            names: of a batch's own files and folders.
            runs: names of its run folders, in which engines write files that begin with a dot.
        """
        others = []
        for run in runs:
            inner = self._listed(run)
            if any(name.removeprefix(f"{run}/").startswith(".") for name in inner):
                return None
            others += inner[:1]
        own = [found for name in names for found in self._listed(name)]
        return next(iter([*own, *others]), None)

    def _listed(self, name: str) -> list[str]:
        """Return the files at or below a place of the batch's folder, by their names in it."""
        with suppress(FileNotFoundError):
            found = sorted(map(str, self._found.find(f"{self._place}/{name}")))
            return [path[len(self._place) :].strip("/") for path in found]
        return []

    def run(self, name: str) -> StoredRun:
        """Return a run folder on the store."""
        return stored_run(self.url, name, self._should_stop)

    def fetch(self, name: str) -> None:
        """Download the files of a run that the page and the record need."""

        def wanted(file: str) -> bool:
            self._there.add(f"{name}/{file}")
            return file in SHOWN or file.startswith(f"{CROPS}/")

        self.run(name).fetch(own_folder(self.folder, name), wanted)

    def is_there(self, name: str) -> bool:
        """Whether a fetched run has a file, by its name in the batch's folder."""
        return name in self._there

    def stamp(self, name: str) -> list[Any]:
        """Return a mark that changes with a file of the batch's folder; OSError if it is gone."""
        return sign(self._found.info(f"{self._place}/{name}"))

    def put(self, *names: str) -> None:
        """Upload files of the batch's folder, by their names."""
        for name in names:
            if (self.folder / name).is_file():
                self._found.put_file(str(self.folder / name), f"{self._place}/{name}")


class StoredRecord(BatchRecord):
    """The state of a batch on a store, from hashes and marks of its files, without local copies."""

    def __init__(self, store: Store) -> None:
        self._store = store
        super().__init__(store.folder)

    def _stamps(self, run: Path, files: Iterable[Path]) -> dict[str, list[Any]]:
        return self._store.run(run.name).marks()

    def _stamp(self, path: Path) -> list[Any]:
        return self._store.stamp(path.relative_to(self.folder).as_posix())


def localized(
    rows: Sequence[Row], store: Store | None, cluster: str | None, context: Context
) -> tuple[list[Row], list[Wrong]]:
    """Replace addresses in rows by folders of this machine; return the rows, and wrong ones.

    The parts run on `cluster`; None for this machine.
    """
    found, wrong = [], []
    for row in rows:
        if any(is_url(value) for value in row.options.values()):
            try:
                if cluster and store is None:
                    raise ConfigError(
                        "With --cluster, a scene on a store needs a run folder on a store.",
                        "Give --run-dir an address, too.",
                    )
                options = local_options(row.options, context)
            except EngineError as error:
                wrong.append(Wrong(line=row.line, text=f"Scene '{row.name}': {error}"))
                continue
            row = replace(row, options=options, asked=row.options)
        url = store.url if store else ""
        found.append(replace(row, store=url, elsewhere=bool(cluster)))
    return found, wrong
