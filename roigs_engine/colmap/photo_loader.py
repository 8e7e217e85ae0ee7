"""Loads a model's usable photos: poses, cameras, files and masks."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..context import QUIET, Context
from ..errors import SceneError
from ..formats.names import same_name
from ..formats.rois import FAR
from ..model.rotations import rotation_entries
from ..model.scene import Float64, PosedImage, SfmScene
from ..photos.contents import FILE as CONTENTS
from ..photos.contents import read_contents
from ..photos.files import PhotoFolder
from ..photos.headers import check_complete, photo_size
from ..photos.mask_paths import USUAL_MASKS, MaskFiles, MaskOptions
from ..photos.rotation import AS_STORED, rotation_tag, turned_size
from . import camera_masks, lenses, undistort
from .records import Model, ModelImage, lens_in_words
from .rotations import Cloud, StoredPhoto, find_turns

MISSING = "missing on disk"
UNPOSED = "without a pose"
WRONG_SIZE = "wrong size"
UNREADABLE = "unreadable"
NO_CAMERA = "without a camera"
DUPLICATE = "twice in the model"
CANNOT_UNDISTORT = "cannot be undistorted"  # follows the camera's model in messages
APPROXIMATE = "pycolmap is not installed: lens distortion is ignored, so cameras differ slightly."
HINT_SHAPE = "Give the model's own photos (--images), not cropped or turned."
HINT_SIDE = "The photos are on their side: give the model's own photos (--images)."
Shrink = Callable[[int, int], tuple[int, int]]


def photo_name(image: ModelImage) -> str:
    """The photo's name in the scene, with `/` between folders on all systems."""
    return image.name.replace("\\", "/")


def pose_of(image: ModelImage) -> Float64 | None:
    """(4, 4) world to camera; None if the stored numbers are not a pose."""
    numbers = np.concatenate([image.quaternion, image.translation])
    if not (np.abs(numbers) < FAR).all():
        return None
    norm = float(np.linalg.norm(image.quaternion))
    if norm < 1e-12:
        return None
    w, x, y, z = image.quaternion / norm
    pose = np.eye(4)
    pose[:3, :3] = np.reshape(rotation_entries(w, x, y, z), (3, 3))
    pose[:3, 3] = image.translation
    return pose


class Skip(NamedTuple):
    """Why a photo cannot be used: the reason in few words, details and a hint."""

    reason: str
    text: str = ""
    hint: str = ""


def stored_photo(image: ModelImage, model: Model, photos: PhotoFolder) -> StoredPhoto | Skip:
    """A model's photo on disk, or why it must be skipped."""
    pose, path = pose_of(image), photos.find(image.name)
    camera = model.cameras.get(image.camera_id)
    if pose is None:
        return Skip(UNPOSED)
    if camera is None:
        return Skip(NO_CAMERA)
    if path is None:
        return Skip(MISSING)
    try:
        size = photo_size(path)
        check_complete(path)
    except SceneError as error:
        return Skip(UNREADABLE, error.message.rstrip("."), error.hint or "")
    return StoredPhoto(
        key=image.image_id,
        name=photo_name(image),
        path=path,
        camera=camera,
        world_to_camera=pose,
        size=size,
        tag=rotation_tag(path),
    )


def _identity(path: Path) -> tuple[object, ...]:
    """A key that is equal for all spellings of a file's name, so that each photo counts once.

    Spellings are `a.jpg`, `./a.jpg`, a path through a link to a folder, and `A.JPG` where case is
    ignored. A link to a file is a photo of its own.
    """
    try:
        state = path.stat()
    except OSError:  # the file has disappeared; its reader reports this
        return (path,)
    real = same_name(os.path.realpath(path))
    return state.st_dev, state.st_ino, same_name(path.name), real


class PhotoLoader:
    """Separates a model's usable photos from skipped ones, and plans their undistortion.

    Attributes:
        posed: image id -> photo, with its final camera and the original file.
        skipped: reason -> names.
        why: reason -> details for one of these photos.
    """

    def __init__(
        self,
        model: Model,
        photos: PhotoFolder,
        shrink: Shrink,
        cloud: Cloud,
        *,
        pixels: bool = True,
        masks: MaskOptions = USUAL_MASKS,
        context: Context = QUIET,
    ) -> None:
        """Args: `pixels`: False if only cameras are needed; `masks`: see `load_colmap`."""
        self._approximate = False
        self._pixels = pixels
        self._masks = masks
        self._mask_files = MaskFiles(photos.folder, masks.folder)
        self._names = [photo_name(image) for image in model.images]
        self.skipped: defaultdict[str, list[str]] = defaultdict(list)
        self.why: dict[str, Skip] = {}
        self.posed: dict[int, PosedImage] = {}
        self._plans: dict[int, undistort.UndistortionPlan] = {}
        found: dict[int, StoredPhoto] = {}
        names: set[str] = set()
        files: set[tuple[object, ...]] = set()
        for image in sorted(model.images, key=lambda image: image.image_id):
            context.check_cancelled()
            name = photo_name(image)
            if name in names or image.image_id in found:
                self.skipped[DUPLICATE].append(name)
                continue
            names.add(name)
            photo = stored_photo(image, model, photos)
            if photo == Skip(MISSING) and MISSING not in self.why:  # slow: once
                photo = Skip(MISSING, *photos.missing(name))
            if isinstance(photo, Skip):
                self._leave_out(name, photo)
            elif (identity := _identity(photo.path)) in files:
                self.skipped[DUPLICATE].append(name)
            else:
                files.add(identity)
                found[image.image_id] = photo
        turns = find_turns([*found.values()], cloud, context)
        for photo in found.values():
            context.check_cancelled()
            skip = self._add(photo, turns.get(photo.key, AS_STORED), shrink)
            if skip is not None:
                self._leave_out(photo.name, skip)
        if self._approximate:
            context.warn(APPROXIMATE)

    def _leave_out(self, name: str, skip: Skip) -> None:
        self.skipped[skip.reason].append(name)
        self.why.setdefault(skip.reason, skip)

    def _add(self, photo: StoredPhoto, turn: int, shrink: Shrink) -> Skip | None:
        """Add the photo, or return why it must be skipped."""
        path, camera, size = photo.path, photo.camera, turned_size(photo.size, turn)
        if not photo.fits(turn):
            text = f"{photo.name} has {size[0]} x {size[1]} pixels, its camera"
            text += f" {camera.width} x {camera.height}: another shape"
            return Skip(WRONG_SIZE, text, HINT_SIDE if photo.on_its_side else HINT_SHAPE)
        pinhole = lenses.as_pinhole(camera)
        try:
            if pinhole is not None:
                target = pinhole.resized(*shrink(*size))
            elif self._pixels or lenses.has_pycolmap():
                plan = undistort.plan_undistortion(path, camera, size, shrink, turn)
                self._plans[photo.key], target = plan, plan.target
            else:
                self._approximate = True
                target = lenses.without_distortion(camera).resized(*shrink(*size))
        except SceneError:
            return Skip(f"{camera.model} {CANNOT_UNDISTORT}")
        lens = "" if pinhole else lens_in_words(lenses.resized_lens(camera, *size))
        self.posed[photo.key] = PosedImage(
            name=photo.name,
            path=path,
            camera=target,
            world_to_camera=photo.world_to_camera,
            turn=turn,
            distorted=pinhole is None,
            lens=lens,
        )
        return None

    def load(self, cache: Path | None, context: Context = QUIET, *, contents: bool = False) -> None:
        """Identify and mask photos; with `pixels`, skip damaged ones and undistort distorted ones.

        `cache`: see `load_colmap`. Raises as `undistort_all` and `make_masks`.
        """
        if self._pixels or cache is not None:
            self._identify(cache, context)
            if self._masks.used:
                self._mask(cache, context)
        if self._masks.boxes:
            self._mask_objects(cache, context)
        if self._pixels:
            self._undistort(cache, context)

    def _identify(self, cache: Path | None, context: Context) -> None:
        """Give the photos their digests; skip damaged ones."""
        photos = {image.name: image.path for image in self.posed.values()}
        found = read_contents(photos, cache and cache / CONTENTS, context, check=self._pixels)
        for key, image in list(self.posed.items()):
            content = found[image.name]
            if content.whole is False:
                self._skip(key, UNREADABLE)
                continue
            digest = content.digest + content.colours  # determines the pixels
            if key in self._plans:
                self._plans[key] = replace(
                    self._plans[key], digest=content.digest, colours=content.colours
                )
                digest = self._plans[key].key()
            elif image.turn != AS_STORED:
                digest = f"{digest}-{image.turn}"
            self.posed[key] = replace(
                image, file_digest=content.digest, digest=digest, exif_exposure=content.exposure
            )

    def _mask(self, cache: Path | None, context: Context) -> None:
        """Give the photos their masks; skip those that are hidden completely."""
        plans = {}
        for key, image in self.posed.items():
            plan = camera_masks.find_mask(
                image.name,
                image.path,
                image.file_digest,
                self._mask_files,
                self._masks,
                turn=image.turn,
            )
            if plan is not None:
                plans[key] = self._for_camera(plan, key)
        made = camera_masks.make_masks(plans, cache, context, write=self._pixels)
        for key, (mask, share) in made.items():
            if not share:
                self._skip(key, camera_masks.HIDDEN)
            elif share < 1:
                image, digest = self.posed[key], self.posed[key].digest
                if key in self._plans:
                    self._plans[key] = replace(
                        self._plans[key], counted=plans[key].whole, mask=mask.digest
                    )
                    digest = self._plans[key].key()
                self.posed[key] = replace(image, mask=mask, digest=digest)
        if self._pixels:
            used = sum(0 < share < 1 for _, share in made.values())
            camera_masks.mention_masks(used, self._mask_files, self._names, context)

    def _for_camera(self, plan: camera_masks.MaskPlan, key: int) -> camera_masks.MaskPlan:
        """The plan of a mask for the photo's camera."""
        camera = self.posed[key].camera
        target = (camera.width, camera.height)
        return replace(plan, undistortion=self._plans.get(key), target=target)

    def _skip(self, key: int, reason: str) -> None:
        self.skipped[reason].append(self.posed.pop(key).name)
        self._plans.pop(key, None)

    def _mask_objects(self, cache: Path | None, context: Context) -> None:
        """Give the photos the masks of the boxes' objects."""
        if self._pixels and not self._masks.other_boxes:
            camera_masks.mention_folders(self._mask_files, self._masks.boxes, self._names, context)
        found = camera_masks.plan_object_masks(self.posed, self._mask_files, self._masks)
        plans = {(key, box): self._for_camera(plan, key) for (key, box), plan in found.items()}
        made = camera_masks.make_masks(plans, cache, context, write=self._pixels)
        for (key, box), (mask, _) in made.items():
            image = self.posed[key]
            self.posed[key] = replace(image, objects={**image.objects, box: mask})

    def _undistort(self, cache: Path | None, context: Context) -> None:
        if not self._plans:
            return
        made = undistort.undistort_all(self._plans.values(), cache, context)
        for key, plan in self._plans.items():
            image, path = self.posed[key], made.get(plan.key())
            if path is None:
                self.skipped[UNREADABLE].append(image.name)
                del self.posed[key]
                continue
            remake = partial(undistort.undistort_again, plan, path)
            self.posed[key] = replace(
                image, path=path, remake=remake, distorted=False, lens="", turn=AS_STORED
            )


def without_damaged(scene: SfmScene, context: Context = QUIET) -> SfmScene:
    """Remove the damaged photos of a scene loaded without pixels; SceneError: all are damaged."""
    found = read_contents({i.name: i.path for i in scene.images}, context=context)
    damaged = tuple(name for name, content in found.items() if not content.whole)
    if len(damaged) == len(scene.images):
        raise SceneError(f"All {len(damaged)} photos are damaged.", "Restore the files.")
    if not damaged:
        return scene
    skipped = scene.skipped | {
        UNREADABLE: tuple(sorted((*scene.skipped.get(UNREADABLE, ()), *damaged)))
    }
    return replace(scene.without(damaged), skipped=skipped)
