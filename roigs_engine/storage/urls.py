"""Addresses of stores, and the file system of an address."""

from __future__ import annotations

import hashlib
import math
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from ..context import Context
from ..errors import ConfigError, RunFolderError, Stopped
from ..formats.files import LARGEST, is_link
from ..formats.text import first_line
from ..requests.values import SCHEME, SECRET, without_secrets

LOST = ("memory",)
"""Kinds of addresses for data in the memory of this process."""
STORES = (
    *("s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oss", "oci", "hdfs", "webhdfs"),
    *("http", "https", "webdav", "ftp", "sftp", "ssh", "smb", "hf", "file", *LOST),
)
"""Allowed kinds of addresses. A batch table may come from an untrusted person, and fsspec supports
some kinds, such as `dask`, whose servers can run programs on this machine."""
PACKAGES = {
    "s3fs": ("s3", "s3a"),
    "gcsfs": ("gs", "gcs"),
    "adlfs": ("abfs", "abfss", "az", "adl"),
    "aiohttp": ("http", "https"),
    "paramiko": ("sftp", "ssh"),
    "ossfs": ("oss",),
    "ocifs": ("oci",),
    "pyarrow": ("hdfs",),
    "webdav4": ("webdav",),
    "smbprotocol": ("smb",),
    "huggingface_hub": ("hf",),
}
"""Package that fsspec needs -> kinds of addresses."""
ENDPOINTS = ("AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3")
"""Environment variables with the address of an S3 server."""
HOME = "ROIGS_CACHE"
"""Environment variable with the folder for this machine's copies."""


SILENT = 120.0
"""Seconds without an answer after which a store counts as unreachable."""
SLOWEST = 64_000
"""Bytes per second: an upload gets the time for this rate in addition to `SILENT`."""
GRACE, UPLOAD = 5.0, 60.0
"""Seconds for which a call continues after a stop request; for `upload`, which saves work."""
READS = ("cat_file", "find", "get_file", "info")
"""Calls that raise FileNotFoundError if a file is missing."""


class StoreError(RunFolderError):
    """A store cannot be read or written, at least now."""


@contextmanager
def guarded(place: str, *passes: type[Exception]) -> Iterator[None]:
    """Turn any error into a StoreError, because each kind of store has its own errors."""
    try:
        yield
    except Exception as error:
        if isinstance(error, (StoreError, Stopped, *passes)):
            raise
        text = f"Cannot use {place:.200} ({reason(error)})."
        raise StoreError(text, "Is the store there, with space?") from error


def reason(error: Exception) -> str:
    """The store's message for an error, without secrets: it may contain configured addresses."""
    return f"{without_secrets(first_line(error)):.100}"


class FileSystem:
    """Wraps fsspec's file system `found` of an address; its calls raise only StoreError.

    Calls in `READS` also raise FileNotFoundError if a file is missing.

    A call may wait for ever. So it runs in a thread, which is abandoned soon after a stop was
    requested: the call then raises Stopped. Its files may be half written, as after a kill.

    Args:
        own: a folder of this machine below which links, pipes and devices are refused; empty: none.
        should_stop: whether a stop was requested. After one abandoned call, later calls of its kind
            are abandoned at once.
    """

    def __init__(
        self, found: Any, url: str, own: str = "", should_stop: Callable[[], bool] = lambda: False
    ) -> None:
        self._found, self._url, self._own, self.should_stop = found, url, own, should_stop
        self._grace = {True: UPLOAD, False: GRACE}  # whether it is an upload -> seconds

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._found, name)
        return lambda *given, **options: self._call(name, method, *given, **options)

    def upload(self, file: BinaryIO, target: str) -> None:
        """Upload the rest of an open file, whose name may be replaced meanwhile."""

        def copy(target: str) -> None:
            with self._found.open(target, "wb") as out:
                shutil.copyfileobj(file, out)

        here = file.tell()
        sends = file.seek(0, os.SEEK_END) - here
        file.seek(here)
        self._call("upload", copy, target, sends=sends)

    def _call(self, name: str, method: Any, *given: Any, sends: int = 0, **options: Any) -> Any:
        with guarded(self._url, *([FileNotFoundError] if name in READS else [])):
            if self._own:
                _refuse_links(Path(self._own), given[name == "put_file"])
            if name == "put_file":
                sends = _size(given[0])
            gets = given[1] if name == "get_file" else ""
            given_up = Context(should_stop=self._patience(name, sends, gets))
            return given_up.interruptible(lambda: method(*given, **options))

    def _patience(self, name: str, sends: int, gets: str) -> Callable[[], bool]:
        """A function: whether to abandon a call that begins now; TimeoutError: no answer.

        Args:
            sends: bytes that the call sends.
            gets: the file that it writes on this machine, if any.
        """
        since, size, heard = math.inf, 0, time.monotonic()
        is_upload = name == "upload"
        patience = SILENT + sends / SLOWEST

        def over() -> bool:
            nonlocal since, size, heard
            now = time.monotonic()
            if gets and (there := _size(gets)) != size:  # the file grows
                size, heard = there, now
            since = min(since, now) if self.should_stop() else since
            if math.isinf(since) and now - heard > patience:
                raise TimeoutError("it does not answer")
            if now - since >= self._grace[is_upload]:
                self._grace[is_upload] = 0.0
                return True
            return False

        return over


def _size(path: str) -> int:
    """The size of a file on this machine, 0 if there is none."""
    try:
        return os.stat(path).st_size
    except OSError:
        return 0


def _refuse_links(root: Path, place: str) -> None:
    """Raise StoreError if a path below `root` leads through a link, a pipe or a device."""
    path = root
    for part in Path(place).relative_to(root).parts:
        path /= part
        if is_link(path) or not (path.is_file() or path.is_dir() or not path.exists()):
            raise StoreError(f"{path} is a link, a pipe or a device.", "Delete it.")


def small_files(listed: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The listed files that are small enough for records: others could fill the memory."""
    return [path for path, facts in listed.items() if int(facts.get("size") or 0) <= LARGEST]


def refuse_lost(url: str) -> None:
    """Raise ConfigError if files at an address are lost when this process ends."""
    match = SCHEME.match(url)
    if match and match[1].lower() in LOST:
        raise ConfigError(
            f"Files written to {url:.200} are lost when the command ends.",
            "Use a folder, or a store such as s3://BUCKET/RUNS.",
        )


def home() -> Path:
    """The folder of this machine's copies; the code that writes into it creates it."""
    return Path(os.environ.get(HOME) or Path.home() / ".cache" / "roigs").absolute()


def folder_of(url: str, kind: str) -> Path:
    """This machine's folder for an address; the same in every process."""
    name = hashlib.sha256(url.rstrip("/").encode("utf-8", "surrogateescape")).hexdigest()[:20]
    return home() / kind / name


def file_system(
    url: str, should_stop: Callable[[], bool] = lambda: False, *, own: bool = False
) -> tuple[FileSystem, str]:
    """The file system of an address, and the place in it without a slash at the end.

    With `own`, files will be written there, and links there are refused. `should_stop`: see
    `FileSystem`.

    ConfigError: fsspec or the package for such addresses is missing, the address is not supported,
    or it has a password where none is allowed.
    """
    match = SCHEME.match(url)
    kind = match[1].lower() if match else ""
    if kind not in STORES or "::" in url:
        raise ConfigError(
            f"{url:.200} is not an address of a store.",
            f"It may begin with {', '.join(STORES[:-1])}.",
        )
    for name in ENDPOINTS if kind in PACKAGES["s3fs"] else ():
        if SECRET.search(os.environ.get(name, "")):
            raise ConfigError(
                f"{name} has a password, which S3 does not accept there.",
                "Use AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY.",
            )
    try:
        import fsspec

        found, place = fsspec.core.url_to_fs(url, use_listings_cache=False)
    except ImportError as error:
        missing = (package for package, kinds in PACKAGES.items() if kind in kinds)
        wanted = "fsspec" if error.name == "fsspec" else next(missing, "fsspec")
        raise ConfigError(
            f"{url:.200} needs {wanted}, which is not installed in {sys.executable}.",
            f"Install it ({sys.executable} -m pip install {wanted}), or use a folder.",
        ) from error
    except Exception as error:  # fsspec's file systems raise many kinds of errors
        raise ConfigError(
            f"{url:.200} cannot be used ({reason(error)}).", "Use an address that fsspec knows."
        ) from error
    place = str(place).rstrip("/")
    return FileSystem(found, url, place if own and kind == "file" else "", should_stop), place
