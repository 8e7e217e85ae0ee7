"""Reconstructs a folder of photos, or a video, as a COLMAP project."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..context import Context
from ..errors import ConfigError, SceneError
from ..formats.events import Message
from ..formats.files import write_text
from ..formats.projects import is_video
from ..formats.text import json_digest
from ..machine import machine_memory, usable_cores
from ..photos.mask_paths import MaskOptions
from ..requests.declare import options_of
from ..requests.projects import FEW_PHOTOS, MANY, USUAL, Reconstruct, ReconstructionMethod
from . import database, pairs
from .child import run_stage
from .convert import converted
from .feature_masks import write_masks
from .folder import Folder
from .mapping import MAPPING, add_photos, map_models, map_rest
from .photo_checks import Found, Photo, camera_groups, look_at, unread_in_words, warnings_of
from .report import NOTHING, Reconstruction, as_markdown, findings, warnings_of_matches
from .video import take_frames

FEATURES, MATCHING = "features", "matching"
OF_FEATURES = ("max_side", "features", "cameras", "camera_model")  # options that change features
# Measured bytes of a thread: for each pixel of the resized photo; for each pixel of the file.
SEARCHED, DECODED = 320, 8
REST_PAIRS = 20_000  # most pairs to try for unregistered photos


def find_features(folder: Folder, found: Found, request: Reconstruct, context: Context) -> None:
    """Find features of the photos that have none in the database yet; SceneError if it fails."""
    there = database.feature_counts(folder.database) if folder.database.exists() else {}
    cameras = database.camera_ids(folder.database) if folder.database.exists() else {}
    groups = []
    for group in camera_groups(found.photos, request.cameras):
        names = [photo.name for photo in group if photo.name not in there]
        known = [cameras[photo.name] for photo in group if photo.name in cameras]
        if names:
            groups.append({"names": names, "camera": known[0] if known else -1})
    if not groups:
        return
    total = len(found.photos)
    task = {
        "work": "extract",
        "database": str(folder.database),
        "photos": str(folder.images),
        "groups": groups,
        "threads": threads_in_memory(found.photos, request.max_side, threads_of(request)),
        "max_side": request.max_side,
        # Few photos have little overlap, where more features find more, and few pairs, where they
        # cost less.
        "features": request.features or (MANY if total <= FEW_PHOTOS else USUAL),
        "camera_model": request.camera_model,
        "masks": str(folder.masks) if found.masks else "",
    }
    _run(task, folder, FEATURES, ("descriptors",), total, context)


def threads_of(request: Reconstruct) -> int:
    """The threads of a reconstruction: the requested number, or one for each core."""
    return request.threads or usable_cores()


def threads_in_memory(photos: Sequence[Photo], max_side: int, threads: int) -> int:
    """The number of threads, limited so that finding features takes half of the memory."""
    needed = []
    for photo in photos:
        pixels, shrink = photo.size[0] * photo.size[1], min(1.0, max_side / max(photo.size))
        needed.append(SEARCHED * pixels * shrink**2 + DECODED * pixels)
    return max(1, min(threads, int(machine_memory() / 2 / max(needed))))


def match(
    folder: Folder, wanted: Sequence[database.Pair], settings: Mapping[str, Any], context: Context
) -> None:
    """Match the pairs that the database does not have yet; SceneError if it fails.

    `settings`: `seed` and `threads` of the task.
    """
    there = database.matched_pairs(folder.database)
    missing = [pair for pair in wanted if pair not in there]
    if not missing:
        return
    listed = folder.work("pairs.txt")
    write_text(listed, "".join(map(database.pair_line, missing)), durable=False)
    task = {"work": "match", "database": str(folder.database), "pairs": str(listed), **settings}
    tables = ("matches", "two_view_geometries")  # matching and verifying take half each
    _run(task, folder, MATCHING, tables, len(there) + len(missing), context)


def _run(
    task: dict[str, Any],
    folder: Folder,
    stage: str,
    tables: Sequence[str],
    total: int,
    context: Context,
) -> None:
    """Run a task; its progress is the mean number of rows of `tables`."""

    def done(record: dict[str, Any]) -> int:
        return sum(database.count(folder.database, table) for table in tables) // len(tables)

    run_stage(task, folder.log, stage, total, done, context)


def choose_pairs(
    folder: Folder, names: Sequence[str], request: Reconstruct, context: Context
) -> list[database.Pair]:
    """Choose the pairs of photos to match first."""
    kind = request.pairs
    if kind == "auto":
        kind = "all" if len(names) <= pairs.FEW else "similar"
    if kind == "all":
        return pairs.all_pairs(names)
    described = dict(database.largest_features(folder.database, pairs.LARGEST))
    empty = np.zeros((0, 128), dtype=np.uint8)
    photos = [described.get(name, empty) for name in names]
    scores = pairs.similarities(photos, context, request.seed)
    if kind == "ordered":
        near = pairs.in_order(names, pairs.OVERLAP, pairs.JUMPS)
        return pairs.merged(near, pairs.most_similar(names, scores, pairs.LOOPS))
    near = pairs.in_order(names, pairs.OVERLAP)
    return pairs.merged(pairs.most_similar(names, scores, request.neighbours), near)


def solve(folder: Folder, found: Found, request: Reconstruct, context: Context) -> Reconstruction:
    """Find features, matches and models of the folder's photos; SceneError if pycolmap fails.

    Models are aligned with an earlier one in the folder. If that one can grow, its cameras do not
    move at all. After a stop, the next call resumes.
    """
    names = [photo.name for photo in found.photos]
    seconds: dict[str, float] = {}
    settings = {"seed": request.seed, "threads": threads_of(request)}
    grows = folder.can_grow
    place = {"earlier": str(folder.finished_model or ""), "grows": grows} | settings
    with _timed(seconds, FEATURES):
        find_features(folder, found, request, context)
    with _timed(seconds, MATCHING):
        wanted = choose_pairs(folder, names, request, context)
        match(folder, wanted, settings, context)
    matched = database.matched_pairs(folder.database)
    warnings = warnings_of_matches(names, matched, database.pair_kinds(folder.database))
    for text in warnings:
        context.warn(text)
    if grows:
        context.info("New photos are added to the model: its cameras do not move.")
    with _timed(seconds, MAPPING):
        models = (add_photos if grows else map_models)(folder, len(names), place, context)
    missing = set(names) - models[0].photos.keys() if models else set()
    if missing:
        with _timed(seconds, MATCHING):
            rest = [pair for pair in pairs.all_pairs(names) if missing & {*pair}]
            match(folder, rest[:REST_PAIRS], settings, context)
        with _timed(seconds, MAPPING):
            models = map_rest(folder, models, names, place, context)
    return Reconstruction(
        found=found,
        features=database.feature_counts(folder.database),
        matched=database.matched_pairs(folder.database),
        models=models,
        seconds=seconds,
        warnings=warnings,
    )


@contextmanager
def _timed(seconds: dict[str, float], step: str) -> Iterator[None]:
    began = time.monotonic()
    yield
    seconds[step] = seconds.get(step, 0.0) + time.monotonic() - began


def reconstruct(
    request: Reconstruct,
    masks: MaskOptions,
    context: Context,
    ready: Callable[[Path], None] = lambda folder: None,
) -> Path:
    """Reconstruct photos or a video as a COLMAP project; resumes an earlier call.

    Args:
        request: the options.
        masks: which of the photos' masks are used.
        context: receives progress and warnings.
        ready: called with the folder for a log, once this process may write there.

    Returns:
        The folder of the model.

    Raises:
        ConfigError: the options do not fit the photos.
        SceneError: the photos or a mask cannot be used, or `out` has something else.
        RunFolderError: `out` cannot be written, or another engine is at work there.
        EngineError: pycolmap is missing or too old, or PyAV or pillow-heif is missing and needed.
        Stopped: on request; the next call resumes.
    """
    masks.check()
    source = request.photos
    folder, video = Folder(request.out), is_video(source)
    if request.frames and not video:
        raise ConfigError(f"{source} is no video.", "Leave out --frames.")
    if video and request.pairs == "auto":  # frames are in order
        request = replace(request, pairs="ordered")
    files = {} if video else folder.photos_of(source)
    with folder.held(context.warn):
        ready(folder.work())
        if video:
            files = take_frames(source, folder, request.frames or 0, context)
        found = _taken(files, {} if video else folder.unread_of(source), folder, context)
        place = folder.images if video else source
        found = replace(found, masks=write_masks(found.photos, place, masks, folder, context))
        inputs = {"photos": {p.name: p.digest for p in found.photos}, "masks": dict(found.masks)}
        method = {key: getattr(request, key) for key in options_of(ReconstructionMethod)}
        key = json_digest({"method": method, **inputs})
        if folder.is_done(key):
            context.info(f"{folder.model} is up to date.")
            return folder.model
        features = {key: method[key] for key in OF_FEATURES} | {"masks": inputs["masks"]}
        if restart := folder.begin(found.photos, features):
            context.info(restart)
        result = solve(folder, found, request, context)
        write_text(folder.report, as_markdown(result))
        if not result.models:
            hint = f"Take photos that overlap more, from different places. See {folder.report}."
            raise SceneError(NOTHING, hint)
        for level, text in findings(result):
            context.emit(Message(text=text, level=level))
        folder.take_model(Path(result.models[0].folder))
        folder.finish(key)
    return folder.model


def _taken(
    files: Mapping[str, Path], unread: Mapping[str, int], folder: Folder, context: Context
) -> Found:
    """Convert and inspect the photos, and put them into the folder; `unread`: see `Found`."""
    for text in unread_in_words(unread):
        context.warn(text)
    files = converted(files, folder, context)
    found = look_at(files, folder.work("photos.json"), context)
    for text in warnings_of(found):
        context.warn(text)
    folder.take_photos(found.photos)
    return replace(found, unread=unread)
