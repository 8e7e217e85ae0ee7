"""The folder of a reconstruction: a COLMAP project, and files needed to resume.

SCENE/images has the photos, SCENE/database.db is COLMAP's database, SCENE/sparse/0 the model, and
SCENE/reconstruction.md the report. SCENE/reconstruction has the engine's own files.
"""

from __future__ import annotations

import filecmp
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager, suppress
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

from ..errors import SceneError
from ..formats.files import (
    LEFTOVER,
    atomic_write,
    cannot_write,
    matching,
    own_file,
    own_folder,
    read_record,
    refuse_linked_folders,
    regular,
    write_json,
)
from ..formats.lock import locked
from ..formats.others import first_other
from ..formats.projects import PHOTO_FOLDERS, RECONSTRUCTION, SPARSE, model_suffix
from ..formats.run_files import LOCK
from ..photos.files import EXTENSIONS, HEIC, UNREAD, PhotoFolder
from ..photos.mask_paths import MASKS
from .photo_checks import Photo, unread_in_words

IMAGES, DATABASE, REPORT = PHOTO_FOLDERS[0], "database.db", "reconstruction.md"
WORK, EARLIER = RECONSTRUCTION, "earlier"
RECORD, PHOTOS = "state.json", "photos"
"""The record's file, in the engine's own folder, and its key for the photos."""
VERSION = 1  # increase it if features or matches of older engines become unusable


class Folder:
    """The places in a reconstruction's folder, and its record.

    Attributes:
        root: the folder.
        images, database: the photos, and COLMAP's database.
        model, report: the result, and a report to read.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.images = root / IMAGES
        self.database = root / DATABASE
        self.model = root / SPARSE / "0"
        self.report = root / REPORT

    def work(self, *names: str) -> Path:
        """A path in the engine's own folder."""
        return own_folder(self.root, WORK).joinpath(*names)

    @property
    def masks(self) -> Path:
        """The photos' masks, as pycolmap reads them."""
        return own_folder(self.root, WORK, MASKS)

    @property
    def log(self) -> Path:
        """The log of pycolmap's messages."""
        return self.work("log.txt")

    @contextmanager
    def held(self, warn: Callable[[str], None]) -> Iterator[None]:
        """Keep other engines out while the block runs.

        Raises:
            RunFolderError: another engine is at work here, the folder cannot be written, or a place
                to write is a link.
            SceneError: it has a model, or files with our names, that this command did not make.
        """
        is_new = not self._record.exists()
        if is_new and model_suffix(self.model):
            raise SceneError(f"{self.root} has a model already.", "Give another --out.")
        for path in self._of_others(is_new=is_new):
            raise SceneError(f"{path} was not created by this command.", "Give another --out.")
        with locked(self.work(), warn, "--out"):
            own_folder(self.root, SPARSE, self.model.name)
            refuse_linked_folders(self.work(), self.log, *self._replaced())
            self._bring_back()
            if is_new:  # from now on, files with the engine's names are the engine's
                write_json(self._record, {"version": VERSION, PHOTOS: {}})
            yield

    def _of_others(self, *, is_new: bool) -> Iterator[Path]:
        """Files with our names that are not ours."""
        if not is_new:
            yield from filter(None, [first_other(self.work(), {RECORD: ("version", PHOTOS)})])
            return
        yield from filter(os.path.lexists, (*self._replaced(), self.report))
        for path in matching(self.work(), "*"):
            if not path.name.lstrip(".").startswith(LOCK) and not LEFTOVER.fullmatch(path.name):
                yield path

    def begin(self, photos: Sequence[Photo], features: Mapping[str, Any]) -> str:
        """Prepare for these photos; keeps valid work and removes the rest.

        `features` are the settings that features depend on; if they change, all work is repeated.
        Returns a sentence on what is repeated and why; empty if nothing is.
        """
        state = read_record(self._record)
        digests, known = {photo.name: photo.digest for photo in photos}, state.get(PHOTOS, {})
        why = ""
        if self.database.exists():
            if state.get("version") != VERSION or state.get("features") != features:
                why = "The settings changed, so features are found again."
            elif not isinstance(known, dict) or not known.items() <= digests.items():
                why = "Photos were changed or removed, so features are found again."
        if why:
            self.forget()
            state["apart"] = True  # the ids of photos and features differ from the model's
        state |= {"version": VERSION, "features": features, PHOTOS: digests}
        write_json(self._record, state)
        return why

    def emptied(self, *names: str) -> Path:
        """Empty a folder of the engine; RunFolderError: something in it cannot be removed.

        Remaining files could be links, and pycolmap would write through them.
        """
        folder = self.work(*names)
        try:
            with suppress(FileNotFoundError):
                shutil.rmtree(folder)
            folder.mkdir(parents=True)
        except OSError as error:
            raise cannot_write(folder, error) from error
        return folder

    def forget(self) -> None:
        """Remove the database and everything made from it, except results."""
        for path in self._replaced():
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)

    def _replaced(self) -> list[Path]:
        """Files that this command may remove, because its record says that it created them."""
        files = [
            self.database.with_name(DATABASE + end) for end in ("", "-wal", "-shm", "-journal")
        ]
        return files + [self.work(name) for name in ("models", "snapshots")]

    @property
    def _record(self) -> Path:
        """The record's file, with settings and photos; written before any slow work."""
        return self.work(RECORD)

    def is_done(self, key: str) -> bool:
        """Whether the existing model was made with this key."""
        return self._was_finished() and read_record(self._record).get("done") == key

    @property
    def finished_model(self) -> Path | None:
        """The model that this command made here; None: it made none."""
        return self.model if self._was_finished() else None

    @property
    def can_grow(self) -> bool:
        """Whether there is a finished model, made from the present database."""
        return self._was_finished() and not read_record(self._record).get("apart")

    def _was_finished(self) -> bool:
        done = read_record(self._record).get("done")
        return bool(done) and model_suffix(self.model) is not None

    def finish(self, key: str) -> None:
        """Record that the model was made with this key."""
        self._note(done=key, apart=False, moved="")

    def _note(self, **values: Any) -> None:
        write_json(self._record, read_record(self._record) | values)

    def _bring_back(self) -> None:
        """Move back the model that a killed engine had moved away.

        Without it, cameras and boxes would lose their place.
        """
        moved = read_record(self._record).get("moved")
        if not (isinstance(moved, str) and moved.isdecimal()) or os.path.lexists(self.model):
            return
        kept = own_folder(self.root, WORK, EARLIER, moved)
        if kept.is_dir():
            try:
                kept.rename(self.model)
            except OSError as error:
                raise cannot_write(self.model, error) from error

    def take_model(self, source: Path) -> None:
        """Make the model in `source` the result; an earlier result is kept beside it."""
        own_folder(self.root, SPARSE)
        kept = own_folder(self.root, WORK, EARLIER)
        try:
            self.model.parent.mkdir(exist_ok=True)
            if self.model.exists():
                kept.mkdir(exist_ok=True)
                places = (kept / str(number) for number in count())
                # The first free name: users may have deleted some of the earlier models.
                place = next(path for path in places if not os.path.lexists(path))
                self._note(moved=place.name)
                self.model.rename(place)
            source.rename(self.model)
        except OSError as error:
            raise cannot_write(self.model, error) from error

    def photos_of(self, source: Path) -> dict[str, Path]:
        """Name -> file, for photos below `source` except our own copies; SceneError: none."""
        if not source.is_dir():
            raise SceneError(f"{source} is not a folder.", "Give the folder of the photos.")
        found = self._files_of(source, EXTENSIONS | HEIC)
        if not found:
            unread = " ".join(unread_in_words(self.unread_of(source)))
            hint = "" if unread else "Give the folder of the photos."
            raise SceneError(f"{source} has no photos. {unread}".rstrip(), hint)
        return found

    def unread_of(self, source: Path) -> dict[str, int]:
        """Unsupported format, such as `.NEF` -> number of photos below a folder that have it.

        Photos that the camera also wrote in a supported format do not count.
        """
        if not source.is_dir():
            return {}
        there = {os.path.splitext(name)[0] for name in self._files_of(source, EXTENSIONS | HEIC)}
        names = self._files_of(source, UNREAD)
        alone = [name for name in names if os.path.splitext(name)[0] not in there]
        return dict(Counter(Path(name).suffix.upper() for name in alone))

    def _files_of(self, source: Path, extensions: Set[str]) -> dict[str, Path]:
        """Name -> file, for files below `source` except this folder's own."""
        own = [Path(os.path.realpath(path)) for path in (self.images, self.root / WORK)]
        here = Path(os.path.realpath(source))
        skipped = [path for path in own if not here.is_relative_to(path)]

        @cache
        def is_own(folder: Path) -> bool:
            """Whether the folder is our own, by its real path: a link may lead there."""
            real = Path(os.path.realpath(folder))
            return any(real.is_relative_to(path) for path in skipped)

        files = {name: source / name for name in PhotoFolder(source, extensions).others([])}
        return {name: path for name, path in files.items() if not is_own(path.parent)}

    def take_photos(self, photos: Sequence[Photo]) -> None:
        """Put the photos into `images`: as hard links if possible, otherwise as copies.

        Raises:
            SceneError: another photo with that name is there.
            RunFolderError: it cannot be written.
        """
        for photo in photos:
            target = own_folder(self.root, IMAGES) / photo.name
            if os.path.lexists(target):
                same = False
                with suppress(OSError):
                    same = os.path.samefile(photo.path, target)
                    same = same or filecmp.cmp(photo.path, target, shallow=False)
                if not same:
                    raise SceneError(
                        f"{target} exists and is not {photo.path}.",
                        "Remove it, or give another --out.",
                    )
                continue
            own_file(self.root, f"{IMAGES}/{photo.name}")  # refuses a link
            with suppress(OSError):
                target.parent.mkdir(parents=True, exist_ok=True)
                os.link(os.path.realpath(photo.path), target)
                continue
            # Some file systems have no hard links, and none links to another file system.
            with (
                atomic_write(target, durable=False) as copy,
                open(photo.path, "rb", opener=regular) as file,
            ):
                shutil.copyfileobj(file, copy)
