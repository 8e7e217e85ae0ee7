"""Suggests the next photos of boxed objects: a list of cameras, pictures, and a page to print."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats.files import own_folder, write_bytes, write_json, write_text
from ..formats.names import safe_name
from ..formats.scene_transform import read_transforms, transform_among, transform_file
from ..formats.text import named
from ..requests.projects import Suggest
from .inputs import BoxSource, load_model, load_scene, mask_options, on_device
from .outputs import Result, refuse_inputs, refuse_run_files

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..guidance.box_map import BoxMap
    from ..guidance.known import KnownBox
    from ..guidance.page import Shots
    from ..guidance.suggest import Suggestion
    from ..guidance.words import Units
    from ..model.scene import Camera, Float64, SfmScene

    Draw = Callable[[Camera, Float64, BoxMap], NDArray[np.uint8]]

LIST, PAGE, PICTURES = "suggestions.json", "suggestions.html", "pictures"
STAGE = "suggest"
SIDE = 480  # longest side of the pictures, pixels


@dataclass(frozen=True, kw_only=True)
class Suggested(Result):
    """The suggestions of all boxes, ready for JSON, and the written files."""

    record: dict[str, Any]
    suggestions: Path
    page: Path
    pictures: Path


def suggest(request: Suggest, context: Context = QUIET) -> Suggested:
    """Find the next photos of each box, and write them; EngineError for bad input."""
    from ..guidance.known import known_box
    from ..guidance.page import suggestions_page
    from ..guidance.suggest import suggested
    from ..model.mask_coverage import with_useful_masks

    refuse_run_files(request.out)
    out = request.out
    refuse_inputs([out / LIST, out / PAGE], [request.options_file, request.rois, request.model])
    source = BoxSource.of(request, out)
    masks = mask_options(request, source.names)
    scene = load_scene(request, context, contents=not request.no_look, masks=masks)
    rois = source.boxes(scene)
    scene = with_useful_masks(scene, rois, context)
    source.keep(rois, context)
    units, draw = units_of(request.scene, scene, context), _painter(request, scene, context)
    boxes, started = [], time.monotonic()
    for step, roi in enumerate(rois, start=1):
        known = known_box(scene, roi, context, look=not request.no_look)
        if known.quality is not None and known.quality.unreadable:
            lost = named(known.quality.unreadable)
            context.warn(f"Unreadable photos count as sharp: {lost}.")
        shots = suggested(known, request.count, context)
        boxes.append(_shots(known, shots, units, draw))
        context.progress(STAGE, step, len(rois), started)
    pictures = own_folder(out, PICTURES)
    record: dict[str, Any] = {"metres_per_unit": units.scale, "cameras": [], "boxes": []}
    for box in boxes:
        cameras = [_record(box, number) for number in range(len(box.shots))]
        for camera, jpeg in zip(cameras, box.pictures, strict=True):
            write_bytes(pictures / Path(camera["picture"]).name, jpeg)
        record["cameras"] += cameras
        record["boxes"].append(_box_record(box.known))
    write_json(out / LIST, record)
    write_text(out / PAGE, suggestions_page(boxes, units))
    done = Suggested(record=record, suggestions=out / LIST, page=out / PAGE, pictures=pictures)
    return done.with_places(*_text(boxes, record))


def units_of(folder: Path, scene: SfmScene, context: Context) -> Units:
    """Return metres if the scene was placed in Blender, else the model's units."""
    from ..guidance.words import Units

    centres = {image.name: image.centre for image in scene.images}
    try:
        placed = transform_among(read_transforms(transform_file(folder)), centres)
    except ConfigError as error:
        context.warn(str(error))
        placed = None
    if placed is None:
        return Units(scale=None)
    return Units(scale=float(np.cbrt(np.linalg.det(placed.matrix[:3, :3]))))


def _painter(request: Suggest, scene: SfmScene, context: Context) -> Draw:
    """Return the renderer of the expected pictures: the model, or points and photos."""
    from ..guidance.pictures import PointPictures, from_photos

    if request.model is None:
        points = PointPictures(scene, context)

        def draw(camera: Camera, pose: Float64, found: BoxMap) -> NDArray[np.uint8]:
            image = points.draw(camera, pose)
            if request.no_look:
                return image
            return from_photos(image, found, camera, pose)

        return draw
    context = on_device(context, request.device)
    from ..model.local_frame import LocalFrame
    from ..rasterize.image_files import to_uint8
    from ..rasterize.view import render_view

    frame = LocalFrame.of_scene(scene)
    model = load_model(request.model, frame, context)
    return lambda camera, pose, _: to_uint8(render_view(model, camera, frame.transform(pose)).image)


def _shots(known: Any, shots: Sequence[Suggestion], units: Units, draw: Draw) -> Shots:
    from ..guidance.page import Shots
    from ..guidance.pictures import as_jpeg, with_box
    from ..guidance.words import in_words

    roi, up = known.map.roi, known.places.up
    small = known.map.lens.thumbnail(SIDE)
    poses = [shot.world_to_camera for shot in shots]
    images = [with_box(draw(small, pose, known.map), roi, small, pose) for pose in poses]
    return Shots(
        known=known,
        shots=shots,
        words=[in_words(shot, roi, up, units) for shot in shots],
        pictures=[as_jpeg(image) for image in images],
    )


def _box_record(known: KnownBox) -> dict[str, Any]:
    """Return how well the photos cover a box, and the doubtful photos."""
    from ..guidance.faults import photo_faults
    from ..guidance.figures import exposure_spread, pixels_across, sides_without_photos

    found = known.map
    return {
        "name": found.roi.name,
        "known": found.value,
        "photos": [image.name for image in found.images],
        "pixels": pixels_across(found),
        "exposure_spread": exposure_spread(known.quality),
        "without_photos": sides_without_photos(found),
        "faults": [fault.to_dict() for fault in photo_faults(known)],
    }


def _record(box: Shots, number: int) -> dict[str, Any]:
    """Return a suggested camera in the form of a path file, with further facts."""
    shot, roi = box.shots[number], box.known.map.roi
    name = f"{safe_name(roi.name)}_{number + 1:02d}"
    return {
        "name": name,
        **asdict(shot.camera),
        "world_to_camera": shot.world_to_camera.tolist(),
        "box": roi.name,
        "number": number + 1,
        "gain": shot.gain,
        "known": shot.value,
        "distance": shot.distance,
        "near": shot.near.photo,
        "words": box.words[number],
        "picture": f"{PICTURES}/{name}.jpg",
    }


def _text(boxes: Sequence[Shots], record: dict[str, Any]) -> list[str]:
    lines = []
    for box, known in zip(boxes, record["boxes"], strict=True):
        found = box.known.map
        lines.append(f"Box '{found.roi.name}': {found.value:.0%} covered by its photos.")
        for number, (shot, words) in enumerate(zip(box.shots, box.words, strict=True), start=1):
            lines.append(f"{number:3}  {shot.gain:+.2f} dB  {words}")
        lines += [f"     check {fault['photo']}: {fault['text']}" for fault in known["faults"]]
    return lines
