"""Addresses of stores: what they are, and the file system that one names."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import ConfigError, RunFolderError
from ..formats.files import is_link
from ..formats.text import first_line
from ..requests.values import SCHEME

LOST = ("memory",)
"""Kinds of addresses that are in the memory of this process."""
STORES = (
    *("s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oss", "oci", "hdfs", "webhdfs"),
    *("http", "https", "webdav", "ftp", "sftp", "ssh", "smb", "hf", "file", *LOST),
)
"""Kinds of addresses that are used: a table may be somebody else's, and fsspec knows some kinds,
such as `dask`, whose servers can run programs here."""
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
"""What fsspec needs for which kinds of addresses."""
HOME = "ROIGS_CACHE"
"""Environment variable: the folder of this machine's copies."""


READS = ("cat_file", "find", "get_file", "info")
"""Calls that say by FileNotFoundError that a file is missing."""


class StoreError(RunFolderError):
    """A store cannot be read or written, at least now."""


@contextmanager
def guarded(place: str, *passes: type[Exception]) -> Iterator[None]:
    """Make a StoreError of any error, as each kind of store has errors of its own."""
    try:
        yield
    except Exception as error:
        if isinstance(error, (StoreError, *passes)):
            raise
        text = f"Cannot use {place:.200} ({first_line(error):.100})."
        raise StoreError(text, "Is the store there, with space?") from error


class FileSystem:
    """fsspec's file system `found` of an address, whose calls raise StoreError, and nothing else.

    Those of `READS` raise FileNotFoundError for what is missing.

    Args:
        own: a folder of this machine below which links, pipes and devices are refused; empty: none.
    """

    def __init__(self, found: Any, url: str, own: str = "") -> None:
        self._found, self._url, self._own = found, url, own

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._found, name)

        def call(*given: Any, **options: Any) -> Any:
            with guarded(self._url, *([FileNotFoundError] if name in READS else [])):
                if self._own:
                    _refuse_links(Path(self._own), given[name == "put_file"])
                return method(*given, **options)

        return call


def _refuse_links(root: Path, place: str) -> None:
    """Raise StoreError if there is a link between `root` and a place, or no file at it."""
    path = root
    for part in Path(place).relative_to(root).parts:
        path /= part
        if is_link(path) or not (path.is_file() or path.is_dir() or not path.exists()):
            raise StoreError(f"{path} is a link, a pipe or a device.", "Delete it.")


def refuse_lost(url: str) -> None:
    """Raise ConfigError if what is written there is gone when this process ends."""
    match = SCHEME.match(url)
    if match and match[1].lower() in LOST:
        raise ConfigError(
            f"What is written to {url:.200} is gone when the command ends.",
            "Use a folder, or a store such as s3://BUCKET/RUNS.",
        )


def home() -> Path:
    """The folder of this machine's copies; whoever writes into it makes it."""
    return Path(os.environ.get(HOME) or Path.home() / ".cache" / "roigs").absolute()


def folder_of(url: str, kind: str) -> Path:
    """This machine's folder for an address; the same in every process."""
    name = hashlib.sha256(url.rstrip("/").encode("utf-8", "surrogateescape")).hexdigest()[:20]
    return home() / kind / name


def file_system(url: str, *, own: bool = False) -> tuple[FileSystem, str]:
    """The file system of an address, and the place in it without a slash at the end.

    With `own`, files are written there, and nothing there is read or written through links.
    ConfigError: fsspec, or the package for such addresses, is missing, or it knows none such.
    """
    match = SCHEME.match(url)
    kind = match[1].lower() if match else ""
    if kind not in STORES or "::" in url:
        raise ConfigError(
            f"{url:.200} is not an address of a store.",
            f"It may begin with {', '.join(STORES[:-1])}.",
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
    except Exception as error:  # whatever the file system raises for what it cannot use
        reason = first_line(error)
        raise ConfigError(
            f"{url:.200} cannot be used ({reason:.100}).", "Use an address that fsspec knows."
        ) from error
    place = str(place).rstrip("/")
    return FileSystem(found, url, place if own and kind == "file" else ""), place
