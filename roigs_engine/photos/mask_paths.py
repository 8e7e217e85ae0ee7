"""File names of masks: one rule for training and `reconstruct`.

docs/files.md (Masks) lists the names in their order; they are those of COLMAP and Brush. Masks of
boxes' objects that could not be written beside the photos are in a run folder
(`formats.mask_record.used_mask`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..errors import ConfigError, SceneError
from ..formats.mask_record import box_folders, used_mask
from ..formats.names import same_name
from ..formats.projects import RECONSTRUCTION
from .files import MASK_ENDS, PhotoFolder, is_mask

MASKS = "masks"
"""Name of the masks' folder."""
ANYTHING = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".gif"}


@dataclass(frozen=True, kw_only=True)
class MaskOptions:
    """The masks that the user wants."""

    folder: Path | None = None  # of the masks; None: `masks` beside the photos' folder
    inverted: bool = False  # in files, black marks used pixels; alpha channels are not inverted
    used: bool = True  # False: no masks are used
    boxes: tuple[str, ...] = ()  # boxes whose object masks are used, from the folders `masks/BOX`
    other_boxes: bool = False  # whether the scene has more boxes than these
    objects_inverted: bool = False  # in object masks, black marks the object
    objects: Path | None = None  # folder of object masks for photos without one in `folder`

    def check(self) -> None:
        """Raise ConfigError if `folder` is not a folder."""
        if self.folder is not None and not os.path.isdir(self.folder):
            raise ConfigError(f"{self.folder} is not a folder.", "Give --masks the masks' folder.")


USUAL_MASKS = MaskOptions()


class MaskFiles:
    """The mask files of the photos in one folder.

    Attributes:
        folder: of the masks; need not exist.
    """

    def __init__(self, photos: Path, folder: Path | None = None, *, made: bool = True) -> None:
        """Set where masks are searched.
        Args:
            photos: the photos' folder.
            folder: of the masks; None: `masks` beside it.
            made: whether to include the masks that `reconstruct` has used.
        """
        project = Path(os.path.abspath(photos)).parent
        self._photos = photos
        self.folder = folder or project / MASKS
        self._made = PhotoFolder(project / RECONSTRUCTION / MASKS)
        self._uses_made = made and folder is None

    def of_object(self, box: str, other: Path | None) -> Callable[[str], Path | None]:
        """The function from a photo's name to its mask of a box's object, if it has one.

        `other`: a run's folder of masks of objects. SceneError: two folders have the box's name.
        """
        beside = MaskFiles(self._photos, _only_folder(self.folder, box))
        in_run = None if other is None else MaskFiles(self._photos, _only_folder(other, box))

        def find(photo: str) -> Path | None:
            newer = None if in_run is None else in_run.find(photo, beside=False)
            return used_mask(beside.find(photo, beside=False), newer, beside.folder)

        return find

    def of_no_box(self, boxes: Iterable[str], photos: Iterable[str]) -> list[str]:
        """Names of folders that look like a box's masks, but have no name of these boxes."""
        known = {same_name(box) for box in boxes}
        masks = {same_name(each) for name in photos for kind in mask_names(name) for each in kind}
        found = {}
        for name in self._masks.others([]):
            folder, _, inner = name.partition("/")
            if same_name(inner) in masks and same_name(name) not in masks:
                found[folder] = same_name(folder) in known
        return [folder for folder, is_known in found.items() if not is_known]

    def is_made(self, mask: Path) -> bool:
        """Whether `reconstruct` made that mask; in these, black always marks ignored pixels."""
        return mask.is_relative_to(self._made.folder)

    def find(self, name: str, *, beside: bool = True) -> Path | None:
        """The mask file of the photo with that name; None: it has none.

        `beside`: whether to search among the photos, too, not only in the folder of masks.
        """
        marked, plain = mask_names(name)
        for candidate in (plain[0], *marked, *(() if self._among_photos else plain[1:])):
            found = self._masks.find(candidate)
            if found is not None:
                return found
        if not beside:
            return None
        found = next(filter(None, map(self._beside.find, marked)), None)
        return found or (self._made.find(plain[0]) if self._uses_made else None)

    def unknown(self, photos: Iterable[str]) -> list[str]:
        """Names of the files that are no mask of any of these photos, also not for a box."""
        names = (mask_names(name) for name in photos)
        known = {same_name(name) for marked, plain in names for name in (*marked, *plain)}
        folders = (self._beside,) if self._among_photos else (self._masks, self._beside)
        found = (name for folder in folders for name in folder.others([]))
        return [
            name
            for name in found
            if not known & {same_name(name), same_name(name.partition("/")[2])}
        ]

    @cached_property
    def _among_photos(self) -> bool:
        """Whether masks are in the photos' folder; there, `012.png` is no mask of `012.jpg`."""
        return os.path.realpath(self.folder) == os.path.realpath(self._photos)

    @cached_property
    def _masks(self) -> PhotoFolder:
        return PhotoFolder(self.folder, ANYTHING, keep=lambda name: True)

    @cached_property
    def _beside(self) -> PhotoFolder:
        return PhotoFolder(self._photos, {".png"}, keep=is_mask)


def _only_folder(masks: Path, box: str) -> Path:
    folders = box_folders(masks, box)
    if len(folders) > 1:
        raise SceneError(
            f"{masks} has {len(folders)} folders of masks for the box '{box}':"
            f" {' and '.join(repr(folder.name) for folder in folders[:2])}.",
            "Put all masks of the box into one folder.",
        )
    return folders[0]


def mask_names(photo: str) -> tuple[list[str], list[str]]:
    """The possible names of a photo's mask: with the ending of masks, and plain ones."""
    photo = photo.replace("\\", "/")
    folder, slash, name = photo.rpartition("/")
    stems = dict.fromkeys((photo, folder + slash + os.path.splitext(name)[0]))
    return [stem + end for stem in stems for end in MASK_ENDS], [f"{stem}.png" for stem in stems]
