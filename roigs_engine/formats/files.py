"""Atomic writes that never follow links, and reads of regular files only.

The rules for files in a run folder or `--out`:

- A file appears under its name when it is complete. A link in its place is replaced.
- A folder below it must not be a link. The folder itself may be one: the user names it.
- A file that is read must be a regular file. Reading a pipe or a device might never end.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import secrets
import stat
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, TextIO

from ..errors import EngineError, RunFolderError
from . import os_lock
from .names import inner_path
from .text import RepeatedKeyError, parse_json

UNREADABLE = "Check that the file exists and that you may read it."
DAMAGED = "Write the file again, or choose another."

# Names of the temporary files of `atomic_write`: process number and a random number.
LEFTOVER = re.compile(r"\..+\.\d+-[0-9a-f]{8}\.part")
ABANDONED = 86400.0  # seconds without a change, where the file system has no locks
IN_THE_WAY = {
    *(errno.EEXIST, errno.ENOTEMPTY, errno.EISDIR, errno.ENOTDIR),
    *(errno.EINVAL, errno.ELOOP, errno.ENXIO),
}
JUNCTION = 0xA0000003  # Windows: reparse tag of a link to a folder; missing in `stat` elsewhere


def matching(folder: Path, pattern: str) -> list[Path]:
    """Names in a folder that match a pattern, sorted; nothing if it cannot be read."""
    try:
        return sorted(folder.glob(pattern))
    except OSError:
        return []


def is_link(path: Path) -> bool:
    """Whether a name is a link, or a junction of Windows; False if it does not exist."""
    try:
        status = os.lstat(path)
    except OSError:
        return False
    return stat.S_ISLNK(status.st_mode) or getattr(status, "st_reparse_tag", 0) == JUNCTION


def own_folder(root: Path, *names: str) -> Path:
    """The folder `root`/`names`, where files may be written; it need not exist.

    Args:
        root: a run folder, or another one that the user has named.
        names: folders below it; each may hold `/`.

    Raises:
        RunFolderError: a name leads out of `root`, one of them is a link, or one is no folder.
    """
    folder, below = Path(root), Path(*names)
    _refuse_no_folder(folder)
    if below.parts and inner_path(str(below)) is None:
        raise _leads_out(folder, str(below))
    for name in below.parts:
        folder /= name
        if is_link(folder):
            raise _linked(folder)
        _refuse_no_folder(folder)
    return folder


def own_file(root: Path, name: str) -> Path:
    """The file `root`/`name`, which may be written; it need not exist.

    Checks names that come from a file or another program, by the rules of POSIX and Windows.

    Args:
        root: as in `own_folder`.
        name: of the file; it may hold `/`.

    Raises:
        RunFolderError: the name leads out of `root`, or a folder in it is a link or no folder.
    """
    if inner_path(name) is None:
        raise _leads_out(root, name)
    file = Path(name)
    return own_folder(root, str(file.parent)) / file.name


def _leads_out(root: Path, name: str) -> RunFolderError:
    return RunFolderError(f"{name!a:.60} is not a valid file name in {root}.", "Rename it.")


def _refuse_no_folder(folder: Path) -> None:
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise cannot_write(folder, OSError(errno.ENOTDIR, "Not a folder"))


def refuse_linked_folders(root: Path, *others: Path) -> None:
    """Raise RunFolderError if a folder anywhere below `root`, or one of `others`, is a link."""
    folders = (Path(parent, name) for parent, names, _ in os.walk(root) for name in sorted(names))
    for path in (*others, *folders):
        if is_link(path):
            raise _linked(path)


def _linked(path: Path) -> RunFolderError:
    return RunFolderError(
        f"{path} is a link; results are not written through links.",
        "Remove the link, or choose another folder.",
    )


def cannot_write(path: Path, error: OSError) -> RunFolderError:
    """The error for a file or folder that cannot be written."""
    hint = "Free some space or choose another folder."
    if error.errno in IN_THE_WAY:
        hint = "Move away the file of that name, or choose another folder."
        above = reversed(path.parents)
        path = next((p for p in above if os.path.lexists(p) and not p.is_dir()), path)
    return RunFolderError(f"Cannot write {path} ({error.strerror or error}).", hint)


def regular(path: str, flags: int) -> int:
    """The `opener` for every file that is read: OSError for a pipe, a device or a socket.

    It never waits for one of these. OSError also for a large sparse file: a few bytes of a download
    would fill the memory.
    """
    descriptor = os.open(path, flags | getattr(os, "O_NONBLOCK", 0), 0o666)
    try:
        state = os.fstat(descriptor)
        if stat.S_ISDIR(state.st_mode):
            raise IsADirectoryError(errno.EISDIR, "Is a directory", path)
        if not stat.S_ISREG(state.st_mode):
            raise OSError(errno.EINVAL, "Not a file", path)
        if state.st_size > MOST_HOLES and _is_hole(descriptor, state):
            raise OSError(errno.EFBIG, "Nothing but holes", path)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


MOST_HOLES, LEAST_ON_DISK = 64 << 20, 100
"""Files up to this many bytes may be sparse; of a larger file, more than 1 / this is on disk."""


def _is_hole(descriptor: int, state: os.stat_result) -> bool:
    """Whether a file is sparse: far larger than its blocks on disk; the rest is zeros."""
    on_disk = 512 * getattr(state, "st_blocks", 0)
    if on_disk:
        return LEAST_ON_DISK * on_disk < state.st_size
    try:  # some systems report 0 for every file
        start = os.read(descriptor, 4096)
        os.lseek(descriptor, 0, os.SEEK_SET)
    except OSError:  # it is open for writing only
        return False
    return not any(start)


def unlinked(path: str, flags: int) -> int:
    """The `opener` for files that are changed in place, or whose content goes into another file.

    As `regular`, and OSError (ELOOP) for a link.
    """
    if not hasattr(os, "O_NOFOLLOW") and is_link(Path(path)):
        raise OSError(errno.ELOOP, "Is a link", path)
    return regular(path, flags | getattr(os, "O_NOFOLLOW", 0))


def size_read(path: Path) -> int:
    """Bytes of a file as it is read: of what a link leads to; 0 if it cannot be read."""
    with suppress(OSError):
        return path.stat().st_size
    return 0


LARGEST = 32 << 20
"""Bytes of a text file that is read whole. The engine's own have a few million at most. Parsed as
nested lists, a file of this size takes 0.8 GB and 20 s."""


def read_bytes(
    path: Path, most: int | None = LARGEST, *, opener: Callable[[str, int], int] = regular
) -> bytes:
    """Read a file of at most `most` bytes (None: any size); `opener`: or `unlinked`.

    OSError: it cannot be read, is larger, or is not a regular file.
    """
    with open(path, "rb", opener=opener) as file:
        if most is not None and os.fstat(file.fileno()).st_size > most:
            raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
        return file.read()


def sha256(path: Path) -> str:
    """The SHA-256 of a file, in hexadecimal digits; raises as `read_bytes`."""
    with open(path, "rb", opener=regular) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def open_log(path: Path) -> TextIO:
    """Open a file to append lines of UTF-8; completes a half line that a killed process has left.

    A symbolic link is replaced by an empty file, and a hard link by a copy. OSError: it cannot be
    written, or is not a regular file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if is_link(path):
        path.unlink()
    elif path.exists() and path.stat().st_nlink > 1:
        write_bytes(path, read_bytes(path))
    with open(path, "a+b", opener=unlinked) as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - 1, 0))
        if size and file.read(1) != b"\n":
            file.write(b"\n")
    return open(path, "a", encoding="utf-8", opener=unlinked)


@contextmanager
def atomic_write(
    path: Path, *, durable: bool = True, before: Path | None = None
) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path`; rename it to `path` once the block ends well.

    An earlier file or folder at `path` is untouched until then, and stays if the block fails.

    Args:
        path: of the file.
        durable: wait until the disk has it; otherwise a power cut some seconds later may damage it.
        before: an earlier file at `path` is made durable and renamed to this.

    Raises:
        RunFolderError: the folder cannot be written to, the disk is full, or a pipe or a device is
            in the way.
    """
    path = Path(path)
    temporary, owner = path, None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _tidy(path.parent)
        with suppress(FileNotFoundError):
            kind = os.lstat(path).st_mode
            if not (stat.S_ISREG(kind) or stat.S_ISLNK(kind) or stat.S_ISDIR(kind)):
                raise OSError(errno.EINVAL, "Not a file", path)
        temporary, file, owner = new_temporary(path)
        with file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        if before is not None and path.is_file() and not is_link(path):
            with open(path, "r+b", opener=unlinked) as earlier:
                os.fsync(earlier.fileno())
            os.replace(path, before)
        os.replace(temporary, path)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        if temporary != path:
            with suppress(OSError):
                temporary.unlink()
        if owner is not None:
            os.close(owner)


def new_temporary(path: Path) -> tuple[Path, BinaryIO, int | None]:
    """A new file beside `path`, open for writing, and the descriptor that holds its lock."""
    while True:
        name = f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.part"
        temporary = path.with_name(name)
        file = open(temporary, "wb", opener=_new)  # noqa: SIM115 - the caller closes it
        try:
            owner = os_lock.keep(file)
        except OSError:
            file.close()
            temporary.unlink(missing_ok=True)
            raise
        # `remove_leftovers` of another process may have removed the file before it was locked.
        if owner is None or temporary.exists():
            return temporary, file, owner
        file.close()
        os.close(owner)


@contextmanager
def written_by_name(path: Path) -> Iterator[Path]:
    """Create a temporary file beside `path` for code that opens it by name; remove it at the end.

    The block renames the complete file. After a kill, the next engine removes it.
    """
    temporary, file, owner = new_temporary(path.with_name("copy"))  # `path`'s name may be too long
    try:
        file.close()
        yield temporary
    finally:
        temporary.unlink(missing_ok=True)
        if owner is not None:
            os.close(owner)


def _new(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0), 0o666)


def remove_leftovers(folder: Path) -> None:
    """Delete the temporary files that killed processes have left; those in use stay."""
    for parent, _, names in os.walk(folder):
        for name in names:
            _remove_leftover(Path(parent, name))


_tidied: set[Path] = set()
"""Folders that this process has written to."""


def _tidy(folder: Path) -> None:
    """Delete temporary files of killed processes in a folder before it is first written to.

    Users give a killed command again, so each command tidies the folders it uses.
    """
    if folder not in _tidied:
        _tidied.add(folder)
        with suppress(OSError):
            for name in os.listdir(folder):
                _remove_leftover(folder / name)


def _remove_leftover(path: Path) -> None:
    """Delete a temporary file unless a live process holds its lock."""
    if LEFTOVER.fullmatch(path.name):
        with suppress(OSError):
            _remove_abandoned(path)


def _remove_abandoned(path: Path) -> None:
    if sys.platform == "win32" or is_link(path):
        path.unlink()  # fails on Windows while the file is open
        return
    with open(path, "r+b", opener=unlinked) as file:
        try:
            abandoned = os_lock.take(file)
        except os_lock.NoLocksError:
            abandoned = time.time() - os.fstat(file.fileno()).st_mtime > ABANDONED
        if abandoned:
            path.unlink()


def write_bytes(path: Path, data: bytes, *, durable: bool = True) -> None:
    """Write a file atomically; `durable` as in `atomic_write`."""
    with atomic_write(path, durable=durable) as file:
        file.write(data)


def write_text(path: Path, text: str, *, durable: bool = True) -> None:
    """Write UTF-8 text as `write_bytes`."""
    # File names that are not UTF-8 contain surrogates; these are escaped as in JSON.
    write_bytes(path, text.encode("utf-8", "backslashreplace"), durable=durable)


def write_json(path: Path, value: Any, *, durable: bool = True) -> None:
    """Write `value` as indented JSON as `write_bytes`."""
    write_text(path, json.dumps(value, indent=1, ensure_ascii=False) + "\n", durable=durable)


def read_record(path: Path) -> dict[str, Any]:
    """The JSON object in `path`; empty if there is none, or it is damaged."""
    with suppress(RunFolderError):
        record = read_json(path)
        return record if isinstance(record, dict) else {}
    return {}


def read_json(path: Path, kind: type[EngineError] = RunFolderError, hint: str = DAMAGED) -> Any:
    """The JSON value in `path`: UTF-8, with or without a byte order mark.

    Raises an error of `kind` if the file is missing, unreadable or not JSON (with this `hint`), or
    if an object has a key twice.
    """
    try:
        return parse_json(read_bytes(path))
    except OSError as error:
        raise kind(f"Cannot read {path} ({error.strerror}).", UNREADABLE) from error
    except RepeatedKeyError as error:
        raise kind(f"{path} is ambiguous: {error}.", "Keep one of the two.") from error
    except ValueError as error:
        raise kind(f"{path} is not JSON ({error}).", hint) from error
