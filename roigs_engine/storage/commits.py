"""A run folder on a store: each part commits all of its changes, or none.

Files go to `.objects`, named by their hashes. A commit, a small record of names and hashes, is
written last. Readers use only files named in commits, and check every hash. So they never see an
incomplete upload, on any file system. The commit of the last part has all files under their own
names. Anyone who can write to the store can also write commits, unless they are signed with a key.
"""

from __future__ import annotations

import errno
import hashlib
import hmac
import json
import os
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

from ..errors import RunFolderError, Stopped
from ..formats.files import LEFTOVER, own_file, regular, remove_leftovers, written_by_name
from ..formats.names import inner_path
from ..formats.run_files import CACHE, PREVIEW, UNDISTORTED
from ..formats.text import json_digest, parse_json
from .mirror import sign
from .urls import FileSystem, small_files

COMMITS, OBJECTS, LEASES = ".commits", ".objects", ".leases"
TIDIED = re.compile(rf"{re.escape(COMMITS)}/[^/]+\.json|{re.escape(OBJECTS)}/[0-9a-f]{{64}}")
VERSION = 2
KEY = "ROIGS_STORE_KEY"
"""Environment variable: the secret that signs commits, the same on all machines."""
Entry = dict[str, Any]


class StoredRun:
    """A run folder on a store.

    Args:
        found: the file system.
        place: the run folder's path in it.
    """

    def __init__(self, found: FileSystem, place: str) -> None:
        self._found, self._place = found, place
        self._had: dict[str, Entry] = {}

    def lease_folder(self, part: str) -> str:
        """The folder of a part's lease."""
        return f"{self._place}/{LEASES}/{quote(part, safe='')}"

    def entries(self) -> dict[str, Entry]:
        """Read all commits: file -> its hash `sha`, its `size` and its place `at` on the store."""
        return _entries(self._commits())

    def marks(self) -> dict[str, list[Any]]:
        """Published file -> its size, its hash, and a mark that changes with its content.

        FileNotFoundError: nothing is published, or a file is missing or has another size.
        """
        entries = self.entries()
        listed = self._found.find(self._place, detail=True)
        there = {str(path)[len(self._place) + 1 :]: sign(facts) for path, facts in listed.items()}
        found = {name: there.get(entry["at"], [-1]) for name, entry in sorted(entries.items())}
        gone = [name for name, mark in found.items() if mark[0] != entries[name]["size"]]
        if gone or not found:
            raise FileNotFoundError(errno.ENOENT, "not on the store", *gone[:1])
        return {name: [mark[0], entries[name]["sha"], *mark[1:]] for name, mark in found.items()}

    def fetch(self, folder: Path, wanted: Callable[[str], bool] = lambda name: True) -> None:
        """Bring a folder here to the state of the commits; matching files are not copied again.

        A file that is damaged on the store counts as missing, so its work is repeated.

        Raises:
            RunFolderError: the store cannot be read, a commit is not the engine's, or a folder is
                a link.
        """
        self._had = {}
        remove_leftovers(folder)
        for name, entry in self.entries().items():
            if self._found.should_stop():
                raise Stopped
            if wanted(name):
                target = own_file(folder, name)
                if _fits(target, entry) or self._get(name, entry, target):
                    self._had[name] = entry
        for name in published_files(folder):
            if name not in self._had and wanted(name):
                (folder / name).unlink(missing_ok=True)
        for path in sorted(folder.rglob("*/"), reverse=True):  # inner folders first
            with suppress(OSError):  # the folder is not empty
                path.rmdir()

    def publish(self, folder: Path, part: str, *, last: bool, names: Iterable[str] = ()) -> None:
        """Publish the files that no other commit has; replaces the part's earlier commit.

        Args:
            part: name of the part that made the files.
            last: whether all parts are done; every file then gets its own name on the store.
            names: only these files; empty: all.

        Raises:
            StoreError: the store cannot be written or read.
            OSError: a file here cannot be read.
        """
        only = set(names)
        now = sorted(only or published_files(folder))
        files: dict[str, Entry] = {}
        before = self._commits()
        others = _entries(commit for commit in before if commit["part"] != part)
        for name in now:
            entry = self._put(folder / name, name if last else "")
            if last or entry["sha"] != others.get(name, {}).get("sha"):
                files[name] = entry
        gone = [] if only else sorted(self._had.keys() - set(now))
        serial = max((commit["serial"] for commit in before), default=0) + 1
        body = {"version": VERSION, "serial": serial, "part": part, "files": files}
        body["gone"] = gone
        text = json.dumps(body | {"digest": self._digest(body)})
        self._found.makedirs(f"{self._place}/{COMMITS}", exist_ok=True)
        self._found.pipe_file(self._commit(part), text.encode())
        self._had = {k: v for k, v in self._had.items() if k not in gone} | files
        if last:
            self._tidy(keep=part)

    def put_beside(self, path: Path, name: str) -> None:
        """Store a file under a name in the folder above the run's; StoreError if that fails."""
        above = self._place.rpartition("/")[0]
        self._found.makedirs(f"{above}/{name}".rpartition("/")[0], exist_ok=True)
        self._found.put_file(str(path), f"{above}/{name}")

    def _commit(self, part: str) -> str:
        return f"{self._place}/{COMMITS}/{quote(part, safe='')}.json"

    def _commits(self) -> list[dict[str, Any]]:
        """Read the complete commits, the oldest first; RunFolderError if one is malformed."""
        found = []
        with suppress(FileNotFoundError):
            listed = self._found.find(f"{self._place}/{COMMITS}", detail=True)
            for path in small_files(listed):
                with suppress(FileNotFoundError, ValueError, TypeError, AttributeError, KeyError):
                    body = parse_json(self._found.cat_file(path))
                    digest = str(body.pop("digest"))
                    whole = hmac.compare_digest(digest, self._digest(body))
                    if whole and body["version"] == VERSION:
                        found.append(_checked(body, str(path)))
        return sorted(found, key=lambda body: (body["serial"], body["part"]))

    def _digest(self, body: dict[str, Any]) -> str:
        """The digest of a commit of this run; with a key, a signature."""
        text = json_digest(body | {"run": self._place.rpartition("/")[2]})
        key = os.fsencode(os.environ.get(KEY, ""))
        return hmac.digest(key, text.encode(), "sha256").hex() if key else text

    def _put(self, path: Path, name: str) -> Entry:
        """Store a file by its hash or under its own name; it may be replaced here meanwhile."""
        with open(path, "rb", opener=regular) as file:
            sha = hashlib.file_digest(file, "sha256").hexdigest()
            size = file.tell()
            at = name or f"{OBJECTS}/{sha}"
            target = f"{self._place}/{at}"
            # A file with its plain name may have changed on the store.
            if name or not self._has(target, size):
                file.seek(0)
                self._found.makedirs(target.rsplit("/", 1)[0], exist_ok=True)
                self._found.upload(file, target)
        return {"sha": sha, "size": size, "at": at}

    def _has(self, target: str, size: int) -> bool:
        try:
            return int(self._found.info(target)["size"]) == size
        except FileNotFoundError:
            return False

    def _get(self, name: str, entry: Entry, target: Path) -> bool:
        """Copy a file from the store; returns whether it matches its entry."""
        target.parent.mkdir(parents=True, exist_ok=True)
        with written_by_name(target) as temporary:
            try:
                self._found.get_file(f"{self._place}/{entry['at']}", str(temporary))
            except FileNotFoundError:
                return False
            if not _fits(temporary, entry):
                return False
            os.replace(temporary, target)
            return True

    def _tidy(self, keep: str) -> None:
        """Remove objects and commits that the last commit replaces; leftovers are harmless."""
        for path in [*self._safe_find(COMMITS), *self._safe_find(OBJECTS)]:
            own = TIDIED.fullmatch(path[len(self._place) + 1 :])
            if own and path != self._commit(keep):
                with suppress(RunFolderError):
                    self._found.rm_file(path)

    def _safe_find(self, name: str) -> list[str]:
        with suppress(Exception):
            return list(map(str, self._found.find(f"{self._place}/{name}")))
        return []


def _checked(body: dict[str, Any], path: str) -> dict[str, Any]:
    """Return the commit; RunFolderError if it is malformed or names a file outside the folder."""
    files, gone, serial = body.get("files"), body.get("gone"), body.get("serial")
    if (
        not (isinstance(files, dict) and isinstance(gone, list))
        or not (type(serial) is int and 0 <= serial < 2**53 and isinstance(body.get("part"), str))
        or not all(map(inner_path, [*files, *gone]))
        or not all(map(_is_entry, files.values()))
        or any(str(above) in files for name in files for above in PurePosixPath(name).parents)
    ):
        raise RunFolderError(
            f"{path:.200} is not a commit of the engine.",
            "Find out who wrote it, then delete the file.",
        )
    return body


def _entries(commits: Iterable[dict[str, Any]]) -> dict[str, Entry]:
    files: dict[str, Entry] = {}
    for commit in commits:
        for name in commit["gone"]:
            files.pop(name, None)
        files |= commit["files"]
    return files


def _is_entry(entry: Any) -> bool:
    return (
        isinstance(entry, dict)
        and isinstance(entry.get("sha"), str)
        and type(entry.get("size")) is int
        and inner_path(entry.get("at")) is not None
    )


def published_files(folder: Path) -> list[str]:
    """Names of the files of a run folder that are published."""
    skip = f"{CACHE}/{UNDISTORTED}/"
    found = (p for p in folder.rglob("*") if p.is_file() and not LEFTOVER.fullmatch(p.name))
    return [
        name
        for name in (path.relative_to(folder).as_posix() for path in found)
        if not name.endswith(".lock") and not name.startswith(skip) and name != PREVIEW
    ]


def _fits(path: Path, entry: Entry) -> bool:
    try:
        if path.stat().st_size != entry["size"]:
            return False
        with open(path, "rb", opener=regular) as file:
            return bool(hashlib.file_digest(file, "sha256").hexdigest() == entry["sha"])
    except OSError:
        return False
