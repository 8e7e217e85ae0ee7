"""Makes the masks of one box, from strokes to files; recreates them only if inputs change."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..colmap.photo_pixels import PhotoPixels
from ..context import QUIET, Context
from ..errors import ConfigError, SceneError
from ..formats.files import atomic_write, own_file, remove_leftovers, sha256
from ..formats.mask_record import (
    KEY,
    MADE,
    generated_masks,
    made_of,
    mask_name,
    record_masks,
)
from ..formats.others import first_other
from ..formats.scribbles import Stroke
from ..formats.text import counted
from ..model.roi import OrientedBox
from ..model.scene import SfmScene
from ..photos.headers import content_digest, unreadable
from ..photos.mask_images import mask_png, read_mask
from ..photos.mask_paths import MaskFiles
from .propagation import Knowledge, fenced, make_masks
from .views import View, in_photo, part_around, view_of

NAMED = 3  # photos named in a warning
LEAST_PHOTOS = 6  # the scribbled one and five more


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxMasks:
    """The request for the masks of a box.

    Attributes:
        scene, roi: in the frame used for computing; the scene has no pixels.
        photos: the photos by name, including those with strokes.
        strokes: photo -> its strokes.
        folder: of the box's masks.
        basis: hash of the model or points that carry masks between photos (`basis_digest`).
        anew: whether to recreate masks with the same inputs, so that strokes on other photos help.
    """

    scene: SfmScene
    roi: OrientedBox
    photos: Mapping[str, PhotoPixels]
    strokes: Mapping[str, tuple[Stroke, ...]]
    folder: Path
    basis: str = ""
    anew: bool = False

    def make(self, knowledge: Knowledge, context: Context = QUIET) -> list[str]:
        """Make and write the masks; returns the names of their files.

        The user's masks stay. Masks made from the same inputs also stay, unless `anew`.

        Raises:
            ConfigError: no photo with strokes shows the box, or no stroke is on the object.
            PhotoError, MaskError: a photo, or a user's mask, cannot be used.
            RunFolderError: a mask cannot be written.
            Stopped: on request; no mask has changed then.
        """
        if (other := first_other(self.folder, {MADE: (KEY,)})) is not None:
            raise ConfigError(f"{other} would be replaced.", "Move it, or choose another --out.")
        remove_leftovers(self.folder)
        made = generated_masks(self.folder)
        views = self._views(made, context)
        inputs = _inputs(views, self.strokes, self.basis)
        views = views if self.anew else self._with_kept(views, made, inputs)
        wanted = [view for view in views if view.known is None]
        found = make_masks(views, knowledge, self.roi.centre, context) if wanted else {}
        files = {}
        empty = [view.name for view in views if view.kept is not None and not view.kept.any()]
        for view in wanted:
            mask = view.photo.in_file(in_photo(found[view.name], view.part, view.photo.camera))
            files[mask_name(view.name)] = mask_png(mask)
            if not mask.any():
                empty.append(view.name)
        if empty:
            context.warn(
                f"Box '{self.roi.name}': {counted(len(empty), 'mask')} came out empty:"
                f" {', '.join(empty[:NAMED])}{', …' if len(empty) > NAMED else ''}."
                " Draw on the object there, if the photo shows it."
            )
        names = self._write(files, {mask_name(name): digest for name, digest in inputs.items()})
        count = sum(view.given is None for view in views)
        context.info(
            f"Box '{self.roi.name}': {len(names)} of {counted(count, 'mask')} written to"
            f" {self.folder}."
        )
        return names

    def _views(self, made: Mapping[str, str], context: Context) -> list[View]:
        """The photos that show the box, with their strokes and the user's masks."""
        files, views = MaskFiles(self.folder.parent, self.folder), []
        for image in self.scene.images:
            if image.name not in self.photos:
                continue
            context.check_cancelled()
            part = part_around(self.roi, image.camera, image.world_to_camera)
            if part is not None:
                photo, strokes = self.photos[image.name], self.strokes.get(image.name, ())
                file, given = files.find(photo.name, beside=False), None
                if file is not None and file.relative_to(self.folder).as_posix() not in made:
                    given = photo.of_file(read_mask(file, photo.size))  # the user's mask
                views.append(view_of(photo, self.roi, part, image.world_to_camera, strokes, given))
        if not any(view.is_scribbled or view.given is not None for view in views):
            raise ConfigError(
                f"No stroke lies on box '{self.roi.name}' in a photo.",
                "Draw on the object, and around it, in a photo that shows the box.",
            )
        if not any(view.shows_object for view in views):
            raise ConfigError(
                f"The object of box '{self.roi.name}' has no stroke.",
                "Draw a stroke on the object in a photo that shows it.",
            )
        return views

    def _with_kept(
        self, views: list[View], made: Mapping[str, str], inputs: Mapping[str, str]
    ) -> list[View]:
        """The photos, with existing masks that were made from the same inputs."""
        known = made_of(self.folder)
        found = []
        for view in views:
            name = mask_name(view.name)
            if view.given is None and name in made and known.get(name) == inputs[view.name]:
                mask = view.photo.of_file(read_mask(self.folder / name, view.photo.size))
                view = replace(view, kept=view.part.of_mask(mask))
            found.append(view)
        return found

    def _write(self, files: Mapping[str, bytes], inputs: Mapping[str, str]) -> list[str]:
        """Write masks (name -> file), but not over the user's; returns the written names.

        The record is written first, so that masks of a process killed here count as generated.
        """
        made = generated_masks(self.folder)  # the user may have changed some meanwhile
        paths = {name: own_file(self.folder, name) for name in files}
        names = [name for name in files if name in made or not (self.folder / name).is_file()]
        digests = {name: hashlib.sha256(files[name]).hexdigest() for name in names}
        kept = {name: of for name, of in made_of(self.folder).items() if name not in names}
        record_masks(self.folder, made, digests, made_of=kept)
        for name in names:
            with atomic_write(paths[name], durable=False) as file:
                file.write(files[name])
        now = {name: inputs[name] for name in names}
        record_masks(self.folder, made | digests, made_of=kept | now)
        return names


def masked_photos(
    selected: Sequence[str], seeing: Sequence[str], scribbled: Sequence[str]
) -> list[str]:
    """The photos to make masks for: scribbled ones, selected ones, and more if these are few.

    `selected`: best first; `seeing`: all that see the box; `scribbled`: photos with strokes.
    """
    names = list(dict.fromkeys([*scribbled, *selected]))
    more = [name for name in seeing if name not in names]
    return [*names, *more[: max(0, LEAST_PHOTOS - len(names))]]


VERSION = 2  # increase it if masks from the same inputs change
Strokes = Mapping[str, tuple[Stroke, ...]]


def basis_digest(
    model: Path | None, scene: SfmScene, roi: OrientedBox, rois: Sequence[OrientedBox]
) -> str:
    """Hash of the model's PLY or, without a model, of the sparse points, and of the boxes.

    `rois` are all boxes, which share the Gaussians. SceneError: the model cannot be read.
    """
    if model is None:
        points = hashlib.sha256(np.ascontiguousarray(scene.points).tobytes()).hexdigest()
        return _hash([points, _box(roi)])
    try:
        found = sha256(model)
    except OSError as error:
        raise SceneError(f"Cannot read {model} ({error.strerror}).") from error
    return _hash([found, _box(roi), *(_box(each) for each in rois)])


def _inputs(views: Iterable[View], strokes: Strokes, basis: str) -> dict[str, str]:
    """Photo -> hash of the inputs of its mask; a mask with the same hash is kept.

    The inputs are the photo with its camera and strokes, the strokes at the start, the boxes, and
    the model (`basis`). Strokes that correct another photo are not included, so masks that the user
    has checked do not change.
    """
    views = list(views)
    drawn = [view for view in views if view.is_scribbled]
    first = [view for view in drawn if fenced(view).any()] or drawn
    common = _hash([VERSION, basis, *((each.name, _lines(strokes, each)) for each in first)])
    return {view.name: _hash([common, _photo(view), _lines(strokes, view)]) for view in views}


def _photo(view: View) -> str:
    try:
        content = content_digest(view.photo.path)
    except OSError as error:
        raise unreadable(view.photo.path, error) from error
    return _hash([content, view.photo.lens, view.camera, view.part, view.world_to_camera.tolist()])


def _lines(strokes: Strokes, view: View) -> list[tuple[str, float, list[float]]]:
    lines = strokes.get(view.name, ())
    return [(line.kind, line.width, line.points.tolist()) for line in lines]


def _box(roi: OrientedBox) -> list[list[float]]:
    return [*roi.world_to_box.tolist(), roi.half_extents.tolist()]


def _hash(values: Sequence[object]) -> str:
    return hashlib.sha256(repr(values).encode()).hexdigest()
