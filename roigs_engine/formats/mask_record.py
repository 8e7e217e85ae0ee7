"""Record of the masks that the engine made from scribbles and may replace.

`made.json` beside the masks of a box has three entries by file. "masks" is the SHA-256 of the
written file. "inputs" is a hash of its inputs: a mask with unchanged inputs is kept. "writing"
lists unfinished files, so that masks of a killed process are known as well. All other files, and
masks changed later, are the user's. They are never replaced.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from .files import cannot_write, own_file, read_record, sha256, write_json
from .names import inner_path, same_name

MADE = "made.json"
KEY, WRITING, INPUTS = "masks", "writing", "inputs"


def mask_name(photo: str) -> str:
    """The name of a photo's generated mask, below the folder of its box."""
    return f"{photo}.png"


def box_folders(masks: Path, box: str) -> list[Path]:
    """The folders below `masks` that may contain a box's masks.

    This is the folder with exactly the box's name. If there is none, it is all folders whose names
    differ only in case or in the Unicode form of accents (macOS decomposes them). If there is none
    of these either, it is the folder to create.
    """
    exact = masks / box
    try:
        if exact.is_dir():
            return [exact]
        names = [each.name for each in masks.iterdir() if same_name(each.name) == same_name(box)]
    except OSError:
        return [exact]
    return [masks / name for name in sorted(names)] or [exact]


def used_mask(beside: Path | None, in_run: Path | None, folder: Path) -> Path | None:
    """Choose the mask of a photo that may have two; engine and add-on share this rule.

    A user's mask beside the photos comes first, then the run folder's mask, then a generated mask
    beside the photos, which is older.

    Args:
        beside: the mask in `folder`; None: it has none.
        in_run: the one in the run folder.
        folder: of the box's masks beside the photos.
    """
    if beside is None or in_run is None:
        return beside or in_run
    digests = _recorded(folder).get(beside.relative_to(folder).as_posix(), [])
    return in_run if _unchanged(beside, digests) else beside


def generated_masks(folder: Path) -> dict[str, str]:
    """The unchanged generated masks, name -> SHA-256; empty if the record is damaged."""
    recorded = _recorded(folder).items()
    found = {name: _unchanged(folder / name, digests) for name, digests in recorded}
    return {name: digest for name, digest in found.items() if digest}


def made_of(folder: Path) -> dict[str, object]:
    """Name -> hash of the mask's inputs, where it is known."""
    return _part(read_record(folder / MADE), INPUTS)


def _recorded(folder: Path) -> dict[str, list[object]]:
    """Name -> recorded digests; names that lead out of the folder are skipped."""
    record = read_record(folder / MADE)
    found: dict[str, list[object]] = {}
    for key in (KEY, WRITING):
        for name, digest in _part(record, key).items():
            if inner_path(name):
                found.setdefault(name, []).append(digest)
    return found


def _part(record: Mapping[str, object], key: str) -> dict[str, object]:
    part = record.get(key)
    return part if isinstance(part, dict) else {}


def _unchanged(file: Path, digests: Sequence[object]) -> str:
    """The digest of a file, if it is one of these; else empty."""
    with suppress(OSError, ValueError):  # ValueError: not a valid file name
        digest = sha256(file)
        return digest if digest in digests else ""
    return ""


def record_masks(
    folder: Path,
    masks: Mapping[str, str],
    writing: Mapping[str, str] | None = None,
    *,
    made_of: Mapping[str, object] | None = None,
) -> None:
    """Write the record; RunFolderError if it cannot be written.

    Args:
        folder: of the masks.
        masks: the finished ones, name -> SHA-256.
        writing: the ones to be written next.
        made_of: name -> hash of the mask's inputs.
    """
    record: dict[str, Mapping[str, object]]
    record = {KEY: masks, WRITING: writing or {}, INPUTS: made_of or {}}
    write_json(folder / MADE, {key: dict(sorted(of.items())) for key, of in record.items()})


def remove_masks(folder: Path) -> int:
    """Remove generated masks and their record; returns their number. A user's masks stay.

    RunFolderError: one cannot be removed, or a folder is a link.
    """
    made = generated_masks(folder)
    files = [own_file(folder, name) for name in made]
    for file in (*files, folder / MADE):
        try:
            file.unlink(missing_ok=True)
        except OSError as error:
            raise cannot_write(file, error) from error
    for parent in sorted({(folder / name).parent for name in made} | {folder}, reverse=True):
        with suppress(OSError):  # the folder is not empty
            parent.rmdir()
    return len(made)
