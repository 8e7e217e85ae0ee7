"""Searches for a model's photos on disk: their folder, and the file of each name."""

from __future__ import annotations

import contextlib
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence, Set
from functools import cached_property
from pathlib import Path
from typing import TypeVar

from ..errors import SceneError
from ..formats.files import is_link
from ..formats.names import same_name
from ..formats.projects import PHOTO_FOLDERS, folders_above

EXTENSIONS = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp", ".jp2", ".ppm", ".pgm"}
HEIC = {".heic", ".heif", ".hif"}  # read only by `reconstruct`, which converts them

UNREAD = {
    *(".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dng", ".erf", ".iiq", ".nef", ".nrw", ".orf"),
    *(".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f"),
    *(".avif", ".exr", ".gif", ".hdr", ".jfif", ".jxl", ".psd", ".tga"),
}
"""Extensions of raw photos and other pictures that are not read."""
MASK_ENDS = (".mask.png",)
"""Endings of the names of masks among the photos (`mask_paths`)."""


MOST_FILES = 300_000
"""Most files in a folder of photos. A whole disk has more, and listing it takes minutes."""
EACH_FOLDER = 20  # files: listing a folder takes as long as listing these


def is_mask(name: str) -> bool:
    """Whether a file among the photos is a mask, by its name."""
    return name.lower().endswith(MASK_ENDS)


class PhotoFolder:
    """The photos below a folder, by their names in a model.

    If no photo of the model is at the place that its name gives, photos are matched by the last
    part of their names, if it is unique both in the model and below the folder.

    Attributes:
        folder: need not exist.
        names: all of the model's; empty: photos are searched only where their names say.
        extensions: of the files that are photos.
        keep: whether a file counts, by its name.
    """

    def __init__(
        self,
        folder: Path,
        extensions: Set[str] = EXTENSIONS,
        keep: Callable[[str], bool] = lambda name: not is_mask(name),
        names: Sequence[str] = (),
    ) -> None:
        self.folder = folder
        self.extensions = extensions
        self.keep = keep
        self.names = names

    @cached_property
    def _exists(self) -> bool:
        return os.path.isdir(self.folder)

    @cached_property
    def _files(self) -> dict[str, Path]:
        """Name on disk (with `/`) -> path, for every photo below the folder except hidden ones."""
        files, count = {}, 0
        for parent, names in _folders(self.folder):
            count += EACH_FOLDER + len(names)
            if count > MOST_FILES:
                folders = MOST_FILES // EACH_FOLDER
                text = f"{self.folder} has more than {MOST_FILES:,} files or {folders:,} folders."
                raise SceneError(text, "Give the folder that has the photos alone.")
            for name in sorted(names):
                path = parent / name
                known = path.suffix.lower() in self.extensions and self.keep(name)
                if not known or name.startswith("."):
                    continue
                if path.is_file():  # not a pipe or a device, whose reading could block forever
                    files[path.relative_to(self.folder).as_posix()] = path
        return files

    @cached_property
    def _by_key(self) -> dict[str, Path]:
        files: dict[str, Path] = {}
        for name, path in self._files.items():
            files.setdefault(same_name(name), path)
        return files

    def find(self, name: str) -> Path | None:
        """The path of the photo with that name in the model; None: not found."""
        return self.at(name) or self._moved.get(same_name(name))

    @cached_property
    def _moved(self) -> dict[str, Path]:
        """Key of a name -> path, for photos in other folders than the model says."""
        if any(map(self.at, self.names)):
            return {}
        wanted = {same_name(name) for name in self.names}
        by_last = _single((_last(key), key) for key in wanted)
        files = _single((_last(same_name(name)), path) for name, path in self._files.items())
        return {key: files[last] for last, key in by_last.items() if last in files}

    def missing(self, name: str) -> tuple[str, str]:
        """Why the photo with that name in the model is missing, and what to do."""
        path = self.folder / name.replace("\\", "/")
        if not self._exists:
            return f"there is no folder {self.folder}", HINT_FOLDER
        with contextlib.suppress(OSError, ValueError):  # not a valid file name
            if path.is_dir():
                return f"{path} is a folder", HINT_FOLDER
            if path.is_symlink():
                return f"{path} is a link to a missing file", "Restore the file that it links to."
            if not os.access(path.parent, os.X_OK) and path.parent.exists():
                return f"{path.parent} cannot be opened", "Allow it (chmod +rx), and give --images."
        elsewhere = self.named_as(name)
        if elsewhere:
            places = " and ".join(f"'{each}'" for each in elsewhere[:2])
            return f"{self.folder} has {places}, but no '{name:.60}'", HINT_NAMES
        stem = _stem(same_name(name))
        other = next((each for each in self._pictures if _stem(same_name(each)) == stem), None)
        if other is not None:
            return f"{self.folder} has '{other}' instead of '{name:.60}'", HINT_OTHER
        return f"{self.folder} has no '{name:.60}'", HINT_FOLDER

    @cached_property
    def _pictures(self) -> list[str]:
        """Names of all pictures below the folder, also in unsupported formats."""
        kinds = EXTENSIONS | HEIC | UNREAD
        return [*PhotoFolder(self.folder, kinds, self.keep)._files]

    def named_as(self, name: str) -> list[str]:
        """Names on disk of the files that have the same last part as `name`."""
        last = _last(same_name(name))
        return [each for each in self._files if _last(same_name(each)) == last]

    def at(self, name: str) -> Path | None:
        """The path of the photo at the place that its name gives; None: not found.

        If no file has exactly that name, the name may differ in case, in the kind of slash and in
        the Unicode form of accents. Names that lead out of the folder are not found.
        """
        if not self._exists:
            return None
        for spelling in dict.fromkeys((name, name.replace("\\", "/"))):
            if spelling.startswith("/") or ".." in spelling.split("/") or "\0" in spelling:
                return None
            if os.path.isfile(os.path.join(self.folder, spelling)):
                path = self.folder / spelling
                return path if path.is_relative_to(self.folder) else None  # other drive (Windows)
        return self._by_key.get(same_name(name))

    def others(self, names: Iterable[str]) -> list[str]:
        """Names of the photos on disk that a model's `names` do not include."""
        paths = (self.find(name) for name in names)
        found = {path for path in paths if path is not None}
        rest = {name: path for name, path in self._files.items() if path not in found}
        real = {os.path.realpath(path) for path in found} if rest else set()
        return [name for name, path in rest.items() if os.path.realpath(path) not in real]


HINT_FOLDER = "Give the photos' folder with --images."
HINT_NAMES = "Put the photos where the model's names say, or give another folder with --images."
HINT_OTHER = (
    "Convert the photos to the format that the model names, without turning or cropping them."
)


def _stem(name: str) -> str:
    return os.path.splitext(name)[0]


def _last(name: str) -> str:
    return name.rpartition("/")[2]


Value = TypeVar("Value")


def _single(pairs: Iterable[tuple[str, Value]]) -> dict[str, Value]:
    """The pairs with a unique key."""
    found: dict[str, list[Value]] = {}
    for key, value in pairs:
        found.setdefault(key, []).append(value)
    return {key: values[0] for key, values in found.items() if len(values) == 1}


def _folders(root: Path) -> Iterator[tuple[Path, list[str]]]:
    """Yield `root` and each folder below it with its files' names, except hidden folders.

    Links to folders are followed after all other folders. So a folder that can be reached in
    several ways comes once, if possible under its real name. Links to the root or to a folder above
    it are not followed: other files there do not belong to the photos.
    """
    links, seen = deque([root]), set()
    top = Path(os.path.realpath(root))
    above = {str(folder) for folder in (top, *top.parents)}
    while links:
        for place, folders, names in os.walk(links.popleft()):
            parent, real = Path(place), os.path.realpath(place)
            if real in seen:
                folders.clear()
                continue
            seen.add(real)
            below = sorted(name for name in folders if not name.startswith("."))
            linked = [name for name in below if is_link(parent / name)]
            links += [p for p in map(parent.joinpath, linked) if os.path.realpath(p) not in above]
            folders[:] = [name for name in below if name not in linked]
            yield parent, names


def find_photos(model: Path, images: Path | str | None, names: list[str]) -> PhotoFolder:
    """Find the folder of a model's photos.

    Args:
        model: the model's folder; the search covers the folders from it up to its project's.
        images: the folder, if the caller knows it.
        names: of the model's photos. The first folder that has any of them at its place is used;
            otherwise the first that has any at all; otherwise the first that exists.

    Raises:
        SceneError: `images` is not a folder.
    """
    if images is not None:
        if not os.path.isdir(images):
            raise SceneError(f"{images} is not a folder.", "Give --images the photos' folder.")
        return PhotoFolder(Path(images), names=names)
    roots = folders_above(model)
    folders = [root / name for root in roots for name in PHOTO_FOLDERS]
    existing = [PhotoFolder(folder, names=names) for folder in folders if folder.is_dir()]
    for photos in existing:
        if any(map(photos.at, names)):
            return photos
    beside = [PhotoFolder(root) for root in roots]
    for photos in (*existing, *beside):
        if any(map(photos.find, names)):
            return photos
    return existing[0] if existing else PhotoFolder(roots[-1] / PHOTO_FOLDERS[0])
