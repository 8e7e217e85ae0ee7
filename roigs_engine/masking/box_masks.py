"""The masks of one box: from strokes, photos and files to files."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..colmap.photo_pixels import PhotoPixels
from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats.files import atomic_write, own_folder, remove_leftovers
from ..formats.made_masks import made_masks, mask_name, record_masks
from ..formats.scribbles import Stroke
from ..formats.text import counted
from ..model.roi import OrientedBox
from ..model.scene import SfmScene
from ..photos.mask_files import MaskFiles
from ..photos.masks import mask_png, read_mask
from .propagate import Knowledge, make_masks
from .views import Mask, View, in_photo, part_around, view_of

NAMED = 3  # photos that a warning names
LEAST_PHOTOS = 6  # the scribbled one and five more


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxMasks:
    """What is asked for.

    Attributes:
        scene: in the frame that is computed in, without pixels.
        roi: the box, in that frame.
        photos: the photos by name, those with strokes included.
        strokes: on photos, by their names.
        folder: of the box's masks.
    """

    scene: SfmScene
    roi: OrientedBox
    photos: Mapping[str, PhotoPixels]
    strokes: Mapping[str, tuple[Stroke, ...]]
    folder: Path

    def make(self, knowledge: Knowledge, context: Context = QUIET) -> list[str]:
        """Make and write the masks; returns the names of their files. A person's masks stay.

        Raises:
            ConfigError: no photo with strokes shows the box, or none is on the object.
            PhotoError, MaskError: a photo, or a person's mask, cannot be used.
            RunFolderError: a mask cannot be written.
            Stopped: on request; no mask has changed then.
        """
        remove_leftovers(self.folder)
        made = made_masks(self.folder)
        views = self._views(made, context)
        found = make_masks(views, knowledge, self.roi.centre, context)
        files, empty = {}, []
        for view in views:
            if view.given is None:
                photo = self.photos[view.name]
                mask = photo.in_file(in_photo(found[view.name], view.part, photo.camera))
                files[mask_name(view.name)] = mask_png(mask)
                if not mask.any():
                    empty.append(view.name)
        if empty:
            context.warn(
                f"Box '{self.roi.name}': {counted(len(empty), 'mask')} came out empty:"
                f" {', '.join(empty[:NAMED])}{', …' if len(empty) > NAMED else ''}."
                " Draw on the object there, if the photo shows it."
            )
        return self._write(files)

    def _views(self, made: Mapping[str, str], context: Context) -> list[View]:
        """The photos that show the box, with their strokes and a person's masks."""
        files, views = MaskFiles(self.folder.parent, self.folder), []
        for image in self.scene.images:
            if image.name not in self.photos:
                continue
            context.check_cancelled()
            part = part_around(self.roi, image.camera, image.world_to_camera)
            if part is not None:
                photo, strokes = self.photos[image.name], self.strokes.get(image.name, ())
                given = self._given(photo, files, made)
                views.append(view_of(photo, self.roi, part, image.world_to_camera, strokes, given))
        if not any(view.is_scribbled or view.given is not None for view in views):
            raise ConfigError(
                f"No stroke lies on box '{self.roi.name}' in a photo.",
                "Draw on the object, and around it, in a photo that shows the box.",
            )
        if not any(view.shows_object for view in views):
            raise ConfigError(
                f"Nothing says where the object of box '{self.roi.name}' is.",
                "Draw a stroke on the object in a photo that shows it.",
            )
        return views

    def _given(self, photo: PhotoPixels, files: MaskFiles, made: Mapping[str, str]) -> Mask | None:
        """A person's mask of a photo, at its camera's size; None: there is none."""
        file = files.find(photo.name, beside=False)
        if file is None or file.relative_to(self.folder).as_posix() in made:
            return None
        return photo.of_file(read_mask(file, photo.size))

    def _write(self, files: Mapping[str, bytes]) -> list[str]:
        """Write masks by their names, but not over a person's; returns the names.

        The record comes first: masks of a process that is killed here are known to be made.
        """
        made = made_masks(self.folder)  # a person may have changed some meanwhile
        paths = {name: own_folder(self.folder, *Path(name).parts[:-1]) for name in files}
        names = [name for name in files if name in made or not (self.folder / name).is_file()]
        digests = {name: hashlib.sha256(files[name]).hexdigest() for name in names}
        record_masks(self.folder, made, digests)
        for name in names:
            with atomic_write(paths[name] / Path(name).name, durable=False) as file:
                file.write(files[name])
        record_masks(self.folder, made | digests)
        return names


def masked_photos(
    selected: Sequence[str], seeing: Sequence[str], scribbled: Sequence[str]
) -> list[str]:
    """The photos to make masks for: those selected, some more if these are few, and the scribbled.

    Args:
        selected: for the box, best first.
        seeing: all that see the box.
        scribbled: photos with strokes.
    """
    names = list(dict.fromkeys([*scribbled, *selected]))
    more = [name for name in seeing if name not in names]
    return [*names, *more[: max(0, LEAST_PHOTOS - len(names))]]
