"""The compiled kernels for this processor: found, built if necessary, and loaded.

The libraries have a plain C interface and are loaded with ctypes. So one file per platform and
instruction set works with every Python version. This module imports neither numpy nor torch.
"""

from __future__ import annotations

import ctypes
import functools
import os
import stat
import sys
import warnings
from contextlib import suppress
from pathlib import Path

from ..errors import KernelError
from ..machine import is_memory_full, usable_cores
from . import build

ISA_VARIABLE = "ROIGS_ISA"
PACKAGE_FOLDER = build.SOURCE_FOLDER / "lib"
_BUILD_COMMAND = f"{Path(sys.executable).name} -m roigs_engine.kernels.build"
_RANKING = ("generic", "avx2", "avx512")  # a processor also runs those before its best


@functools.cache
def load() -> ctypes.CDLL:
    """Load the kernels' library for this processor; it uses all usable cores.

    The environment variable ROIGS_ISA selects another instruction set than the best, for
    measurements or to work around a bug. KernelError: there is no library and no compiler to build
    it, or ROIGS_ISA names an instruction set that is missing or cannot run here.
    """
    folder = _folder_with_libraries()
    library = _opened(build.library_path(folder, _platform(), _choose_isa(folder)))
    library.roigs_set_threads(ctypes.c_int(usable_cores()))
    return library


def isa() -> str:
    """The instruction set of the library that `load` returns: avx512, avx2, generic or neon."""
    load()
    return _choose_isa(_folder_with_libraries())


def set_threads(count: int | None) -> None:
    """Set the kernels' number of threads; None: all cores that this process may use."""
    load().roigs_set_threads(ctypes.c_int(usable_cores() if count is None else max(1, count)))


def threads() -> int:
    """The kernels' number of threads."""
    return int(load().roigs_threads())


def available(folder: Path) -> list[str]:
    """Instruction sets with a library in a build's output folder, slowest first."""
    target = _platform()
    isas = build.PLATFORMS[target].isas
    return [name for name in isas if build.library_path(folder, target, name).is_file()]


def _platform() -> str:
    try:
        return build.native_platform()
    except build.BuildError as error:
        raise KernelError(str(error), "Use a computer with an x64 or arm64 processor.") from error


@functools.cache
def _folder_with_libraries() -> Path:
    """The folder to load from; builds the libraries if there are none. KernelError: that fails."""
    cache = _user_cache_folder()
    for folder in (PACKAGE_FOLDER, cache):
        if available(folder):
            if folder is cache:
                refuse_others_code(folder)
            _check_age(folder)
            return folder
    folder = PACKAGE_FOLDER if _is_writable(PACKAGE_FOLDER) else cache
    if folder is cache:
        refuse_others_code(folder)
    try:
        build.build(folder)
    except (build.BuildError, OSError) as error:
        raise KernelError(
            f"The compiled kernels are missing and could not be built: {error}",
            f"Run `pip install ziglang`, then `{_BUILD_COMMAND}`.",
        ) from error
    return folder


def _choose_isa(folder: Path) -> str:
    """The instruction set to load from `folder`: ROIGS_ISA, or the best one that can run."""
    present = available(folder)
    if "generic" in present:
        best = _best_isa(build.library_path(folder, _platform(), "generic"))
        runnable = _RANKING[: _RANKING.index(best) + 1]
    else:
        best, runnable = present[-1], tuple(present)
    wanted = os.environ.get(ISA_VARIABLE, "")
    if not wanted:
        return [name for name in present if name in runnable][-1]
    if wanted not in present:
        raise KernelError(
            f"{ISA_VARIABLE} is {wanted!r}, but the libraries are: {', '.join(present)}.",
            f"Choose one of these, or unset {ISA_VARIABLE}.",
        )
    if wanted not in runnable:
        raise KernelError(
            f"{ISA_VARIABLE} is {wanted!r}, but the best that this processor runs is {best}.",
            f"Unset {ISA_VARIABLE}.",
        )
    return wanted


def _opened(path: Path) -> ctypes.CDLL:
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        if is_memory_full(error):
            raise
        raise KernelError(
            f"The kernels cannot be loaded ({error}).",
            "Install the engine on a disk whose files may be executed (not mounted noexec).",
        ) from error


def _best_isa(generic_library: Path) -> str:
    library = _opened(generic_library)
    library.roigs_best_isa.restype = ctypes.c_char_p
    return str(library.roigs_best_isa().decode("ascii"))


def _check_age(folder: Path) -> None:
    """Warn a developer if the compiled kernels are older than their sources.

    KernelError: their C interface has changed, so that a call would access the wrong memory.
    """
    keys = [build.read_keys(folder, _platform(), name) for name in available(folder)]
    if any(interface != build.interface_key() for _, interface in keys):
        raise KernelError(
            f"The compiled kernels in {folder} belong to another version of the engine.",
            f"Run `{_BUILD_COMMAND}`.",
        )
    if any(source != build.source_key() for source, _ in keys):
        text = "the compiled kernels are older than their sources"
        try:
            warnings.warn(f"{text}: run `{_BUILD_COMMAND}`", stacklevel=3)
        except UserWarning as error:  # PYTHONWARNINGS=error
            raise KernelError(f"{text.capitalize()}.", f"Run `{_BUILD_COMMAND}`.") from error


def _is_writable(folder: Path) -> bool:
    existing = next(parent for parent in (folder, *folder.parents) if parent.exists())
    return os.access(existing, os.W_OK)


def _user_cache_folder() -> Path:
    """The kernels' folder if the package's folder is read-only; one for each source version."""
    return user_cache() / "kernels" / build.source_key()


def refuse_others_code(path: Path) -> None:
    """Refuse a file or folder in the user's cache that others can change, as its code is run.

    Raises:
        KernelError: it, a folder above it, or a folder that a link leads through belongs to
            somebody else. Or all users can write to it, or a group that others may be in.
    """
    if not hasattr(os, "getuid"):
        return
    home, seen = user_cache(), set[Path]()
    ways = [(place, False) for place in (path, *path.rglob("*"))]
    for way, beyond in ways:  # the list grows by the targets of links
        for place in (way, *way.parents):
            if place in seen:
                continue
            seen.add(place)
            ours = beyond or place.is_relative_to(home)
            if place.is_symlink():
                ways.append((place.parent / place.readlink(), ours))
            with suppress(FileNotFoundError):
                status = place.stat()
                foreign = ours and status.st_uid not in (0, os.getuid())
                others = stat.S_IWOTH | (stat.S_IWGRP if _is_shared(status.st_gid) else 0)
                if foreign or (status.st_mode & others and not status.st_mode & stat.S_ISVTX):
                    raise KernelError(
                        f"Others can change {place}, from which the engine loads code.",
                        f"Delete {home}, and make {home.parent} writable for yourself only, or set"
                        " XDG_CACHE_HOME to such a folder.",
                    )


@functools.cache
def _is_shared(group: int) -> bool:
    """Whether others may be in a group: it is neither root's nor this user's private group."""
    import grp
    import pwd

    try:
        user, record = pwd.getpwuid(os.getuid()), grp.getgrgid(group)
    except KeyError:
        return group != 0
    private = group == user.pw_gid and record.gr_name == user.pw_name
    return group != 0 and not (private and set(record.gr_mem) <= {user.pw_name})


def user_cache() -> Path:
    """The user's cache folder, for compiled kernels and the results of their checks."""
    if sys.platform == "win32":
        root = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        root = Path.home() / "Library" / "Caches"
    else:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return root / "roigs"
