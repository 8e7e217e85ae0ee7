"""Converts photos that pycolmap cannot read to JPEG files, with their EXIF data."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager, suppress
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from ..context import Context
from ..errors import SceneError
from ..formats.files import atomic_write, own_file, read_bytes, read_record, write_json
from ..formats.text import counted
from ..machine import package
from ..photos.colours import colours_of, say_srgb
from ..photos.decode import check_whole, to_rgb
from ..photos.files import HEIC
from ..photos.headers import PhotoError, content_digest, exif_of, open_photo
from ..photos.jpeg import MOST_SEGMENT
from ..photos.parallel import in_parallel
from ..photos.tiff import colmap_reads
from .folder import IMAGES, Folder

if TYPE_CHECKING:
    from PIL.Image import Image

STAGE = "convert photos"
FOREIGN = {*HEIC, ".webp", ".jp2"}  # pycolmap's wheels cannot read these
TIFF = {".tif", ".tiff"}  # pycolmap reads some of these differently
QUALITY = 95
ORIENTATION, EXIF_IFD = 0x0112, 0x8769  # EXIF tags
LONG = 1000  # letters of a tag that is not needed, as MakerNote
BYTES = 20 * 50_000_000  # for converting a large photo
RECORD = "converted.json"
SRGB = " sRGB"  # after the digest of a photo whose colours were also converted


def converted(files: Mapping[str, Path], folder: Folder, context: Context) -> dict[str, Path]:
    """Convert photos that pycolmap cannot read to JPEG files in the folder's images.

    Takes and returns name -> file. `a.heic` becomes `a.heic.jpg`. A photo that cannot be read stays
    as it is. Files converted by an earlier call are used again.

    Raises:
        EngineError: pillow-heif is needed, but not installed.
        SceneError: another photo has been converted to that name.
        RunFolderError: the folder cannot be written.
    """
    foreign = [name for name, path in files.items() if _is_foreign(name, path)]
    if not foreign:
        return dict(files)
    heic = [name for name in foreign if Path(name).suffix.lower() in HEIC]
    if heic:
        purpose = f"Reading {counted(len(heic), 'photo')} in HEIC format"
        pillow_heif = package("pillow_heif", purpose, "pillow-heif", "Or convert to JPEG.")
        pillow_heif.register_heif_opener()
    names = {name: f"{name}.jpg" for name in foreign}
    found = {name: path for name, path in files.items() if name not in {*foreign, *names.values()}}
    made = read_record(folder.work(RECORD))  # name -> digest, and SRGB or nothing

    def convert(name: str) -> str:
        target = own_file(folder.root, f"{IMAGES}/{names[name]}")
        return _convert(files[name], target, str(made.get(name, "")))

    try:
        with in_parallel(convert, foreign, BYTES, context, STAGE) as work:
            for name, job in work:
                with suppress(PhotoError):
                    made[name] = job.result()
                good = job.exception() is None
                key = names[name] if good else name
                found[key] = folder.images / names[name] if good else files[name]
    finally:
        write_json(folder.work(RECORD), made)
    changed = sum(str(made.get(name, "")).endswith(SRGB) for name in foreign)
    if changed:
        context.info(
            f"{counted(changed, 'photo')} became JPEG in sRGB; colours outside sRGB are clipped."
        )
    return dict(sorted(found.items()))


def _is_foreign(name: str, path: Path) -> bool:
    """Whether pycolmap cannot read a photo, or reads it differently."""
    suffix = Path(name).suffix.lower()
    if suffix in TIFF:
        with suppress(PhotoError), open_photo(path) as photo:
            return not colmap_reads(photo)
    return suffix in FOREIGN


def _convert(source: Path, target: Path, known: str) -> str:
    """Write a photo as JPEG unless this was done before; returns the record of its file.

    Raises:
        PhotoError: it cannot be read.
        SceneError: the target is another photo.
    """
    try:
        digest = content_digest(source)
    except OSError as error:
        raise PhotoError(f"Cannot read photo {source} ({error.strerror or error}).") from error
    try:
        with _opened(source) as photo:
            record = digest + (SRGB if colours_of(photo).profile else "")
        if target.exists() and known == record:
            return record
        data = _as_jpeg(source)
    except PhotoError:
        raise
    except Exception as error:  # Pillow's readers raise nearly anything on damaged files
        raise PhotoError(f"Cannot read photo {source} ({error}).") from error
    if not target.exists() or known.removesuffix(SRGB) == digest:
        with atomic_write(target, durable=False) as file:
            file.write(data)
    elif read_bytes(target, most=None) != data:
        raise SceneError(
            f"{target} exists and is not {source}.", "Remove it, or give another --out."
        )
    return record


def _as_jpeg(source: Path) -> bytes:
    """Encode the photo as a JPEG file in sRGB; raises nearly anything on damaged files."""
    heic, file = source.suffix.lower() in HEIC, BytesIO()
    if not heic:
        check_whole(source)
    with _opened(source) as photo:
        exif = _exif(photo, heic=heic)
        to_rgb(photo).save(file, format="JPEG", quality=QUALITY, subsampling=0, exif=exif)
    return file.getvalue()


def _exif(photo: Image, *, heic: bool) -> bytes:
    """EXIF data for a JPEG of the photo, which has room for 64 kB: without long tags if needed.

    Empty if they are damaged, or still too long.
    """
    with suppress(Exception):  # Pillow may raise nearly anything on damaged tags
        exif = exif_of(photo)
        if heic:
            exif.pop(ORIENTATION, None)  # reading has already turned it
        if colours_of(photo).profile:
            say_srgb(exif)
        if len(data := exif.tobytes()) > MOST_SEGMENT:
            for tags in (exif, exif.get_ifd(EXIF_IFD)):
                for tag in [tag for tag, value in tags.items() if len(str(value)) > LONG]:
                    del tags[tag]
            data = exif.tobytes()
        return data if len(data) <= MOST_SEGMENT else b""
    return b""


def _opened(source: Path) -> AbstractContextManager[Image]:
    from PIL import Image

    heic = source.suffix.lower() in HEIC
    return Image.open(source, formats=("HEIF",)) if heic else open_photo(source)
