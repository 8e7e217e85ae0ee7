"""Shows photos behind the cameras' views, as training sees them.

Most are shown from the user's files. For a photo with lens distortion, a colour profile or a
rotation, and for files that Blender reads differently, the engine makes a picture once, in a
separate process. Until it is finished, the file itself is shown.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import bpy

from .. import settings
from ..blender import camera_of, is_rendering, load_image
from ..engine.process import EngineProcess
from ..engine.python import FOR_DISTORTION, FOR_PICTURES
from ..errors import AddonError
from ..geometry.photo import Photo
from ..properties import scene_props
from ..windows import Timer, redraw
from . import lookup

SIDE = 3000
"""Longest side of a picture, px: on a screen, as detailed as the largest photos."""
KEPT = 200
"""Most pictures in the cache, about 2 MB each; the oldest are deleted."""
_OURS = re.compile(r"roigs-[0-9a-f]{32}\.jpg")
MARK = "roigs_picture"
"""Custom property of the images of pictures."""
POLL_SECONDS = 0.1
END_SECONDS = 5.0


@dataclass(frozen=True)
class _Making:
    """A picture that the engine is making."""

    photo: Photo
    picture: Path
    process: EngineProcess


_making: _Making | None = None
_wanted: Photo | None = None
"""The photo viewed last, if its picture is still to be made."""
_failed: set[Path] = set()
"""Pictures that could not be made. They are not tried again until Blender restarts."""


def show(data: bpy.types.Camera, photo: Photo) -> None:
    """Show a photo behind the camera's view, unless another picture is there.

    An unreadable photo is not shown: the camera is useful without it. In background mode, where
    Blender calls no timers, this waits for the engine.
    """
    global _wanted
    if not photo.path:
        return
    picture = _picture(photo)
    if picture is None or picture.is_file():
        _put(data, photo, picture or Path(photo.path))
        return
    _put(data, photo, Path(photo.path))
    if picture in _failed or is_rendering():
        return
    _wanted = photo
    if in_background():
        while _step(wait=True):
            pass
    else:
        _timer.start()


def shown(photo: Photo) -> Path:
    """The file that shows a photo as training sees it; its own file until the picture is made."""
    picture = _picture(photo)
    return picture if picture is not None and picture.is_file() else Path(photo.path)


def with_distortion(photo: Photo) -> Path:
    """The file that shows a photo with its distortion, on which strokes and masks are drawn."""
    return Path(photo.path) if photo.lens else shown(photo)


def is_compared(scene: bpy.types.Scene) -> bool:
    """Whether a view through a photo's camera shows the photo beside the Gaussians, not behind."""
    return scene_props(scene).compare_photo and bool(lookup.splats(scene))


def follow(scene: bpy.types.Scene) -> None:
    """Hide the photo behind the active camera's view while the photo is beside the Gaussians."""
    photo = lookup.photo_record(scene.camera) if scene.camera is not None else None
    if scene.camera is None or photo is None or scene.camera.library is not None:
        return
    behind = not is_compared(scene)
    for background in camera_of(scene.camera).background_images:
        if _is_own(background.image, photo) and background.show_background_image != behind:
            background.show_background_image = behind


def in_background() -> bool:
    """Whether Blender calls no timers."""
    return bool(bpy.app.background)


def _picture(photo: Photo) -> Path | None:
    """Return the path of a photo's picture, made or not; None if its own file is shown.

    The name is a hash of all that decides the picture, so a changed photo gets another picture.
    """
    if photo.as_stored:
        return None
    try:
        found = os.stat(photo.path)
    except OSError:
        return None
    text = repr((photo.path, found.st_size, found.st_mtime_ns, photo.lens, photo.turn, SIDE))
    name = hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()[:32]
    return settings.pictures_folder() / f"roigs-{name}.jpg"


def _put(data: bpy.types.Camera, photo: Photo, path: Path) -> None:
    """Make a file the camera's background, in place of the photo's file or an earlier picture."""
    shown = [*data.background_images]
    own = [background for background in shown if _is_own(background.image, photo)]
    if shown and not own:
        return
    if own and _path(own[0].image) == path:
        return
    image = load_image(path, check_existing=True)
    if image is None:
        return
    if path != Path(photo.path):
        image[MARK] = True
    if own:
        before, own[0].image = own[0].image, image
        if before is not None and not before.users:
            bpy.data.images.remove(before)
        return
    background = data.background_images.new()
    background.image = image
    background.frame_method = "STRETCH"
    background.alpha = 1.0
    background.display_depth = "BACK"
    data.show_background_images = True


def _is_own(image: bpy.types.Image | None, photo: Photo) -> bool:
    """Whether an image was put behind a camera here; its file may be on another computer."""
    return image is not None and (image.get(MARK) is not None or _path(image) == Path(photo.path))


def _path(image: bpy.types.Image | None) -> Path:
    return Path(bpy.path.abspath(image.filepath) if image else "")


def _step(*, wait: bool = False) -> bool:
    """Start or finish a picture; return False if none is left. `wait` waits for the engine."""
    global _making, _wanted
    if _making is None:
        if _wanted is None:
            return False
        photo, _wanted = _wanted, None
        _making = _started(photo)
        return True
    if wait:
        _making.process.wait()
    elif _making.process.running() or is_rendering():  # Blender's data must not change then
        return True
    made, _making = _making, None
    result = made.process.result()
    if result.complete and made.picture.is_file():
        for data in _cameras_of(made.photo):
            _put(data, made.photo, made.picture)
        for scene in bpy.data.scenes:
            follow(scene)
        redraw()
    else:
        _give_up(made.picture, result.message)
    return _wanted is not None


def _started(photo: Photo) -> _Making | None:
    """Have the engine make a photo's picture."""
    picture = _picture(photo)
    if picture is None or picture in _failed:
        return None
    arguments = ["show-photo", photo.path, "--out", str(picture), "--max-side", str(SIDE)]
    arguments += ["--turn", str(photo.turn)]
    if photo.lens:
        arguments += ["--lens", photo.lens]
    try:
        picture.parent.mkdir(parents=True, exist_ok=True)
        _remove_oldest(picture.parent)
        engine = settings.engine(FOR_DISTORTION if photo.lens else FOR_PICTURES)
        process = EngineProcess(engine, arguments)
    except (AddonError, OSError) as error:
        _give_up(picture, str(error))
        return None
    return _Making(photo, picture, process)


def _give_up(picture: Path, reason: str) -> None:
    _failed.add(picture)
    print(f"ROI-GS: The photo is shown as it is stored. {reason}".rstrip())


def _remove_oldest(folder: Path) -> None:
    """Delete the oldest of our pictures. Other files stay: the folder may be the user's own."""
    with suppress(OSError):
        ours = [file for file in folder.iterdir() if _OURS.fullmatch(file.name)]
        pictures = sorted(ours, key=lambda file: file.lstat().st_mtime)
        for picture in pictures[: max(0, len(pictures) - KEPT)]:
            picture.unlink()


def _cameras_of(photo: Photo) -> Iterator[bpy.types.Camera]:
    """The cameras that show a photo or are looked through, in all scenes."""
    for scene in bpy.data.scenes:
        for item in lookup.of_kind(scene, "CAMERA"):
            data = camera_of(item)
            shown = len(data.background_images) or item == scene.camera
            if shown and lookup.photo_record(item) == photo:
                yield data


_timer = Timer(_step, POLL_SECONDS, persistent=True)


def register() -> None:
    """Do nothing: pictures are made when a photo is viewed."""


def unregister() -> None:
    """End the engine's process."""
    global _making, _wanted
    _timer.stop()
    _wanted = None
    _failed.clear()
    if _making is not None:
        _making.process.kill()
        _making.process.wait(END_SECONDS)
        _making.process.result()
        _making = None
