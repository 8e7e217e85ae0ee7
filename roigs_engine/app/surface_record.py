"""The JSON record of a surface, and its section in a run's reports."""

from __future__ import annotations

import base64
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path

from ..errors import RunFolderError
from ..formats import run_files
from ..formats.files import (
    is_link,
    matching,
    own_folder,
    read_bytes,
    read_record,
    unlinked,
    write_text,
)
from ..formats.text import markdown_text
from ..formats.web_page import html_text
from ..photos.png import PNG

LEAST = 0.005  # share of a surface: smaller holes are not listed
RECORD, PICTURE = ".surface.json", ".surface.png"


@dataclass(frozen=True, kw_only=True)
class SurfaceRecord:
    """The record of a surface; lengths in units of the COLMAP model.

    Attributes:
        box: its name, or that of the background (`run_files.SURROUNDINGS`).
        file: path in the run folder.
        result: SHA-256 of the box's PLY beside it; empty if there is none.
        size: of its bounding box, along the box's axes.
        volume: None if it has holes.
        filled: share of the surface that no photo shows and that was closed.
        untextured: share of the surface without a colour from a photo.
        unseen: side (`above`, `below`, `beside`) -> approximate share of open holes there, which no
            photo shows.
    """

    box: str
    file: str
    result: str
    faces: int
    vertices: int
    parts: int
    size: tuple[float, float, float]
    area: float
    volume: float | None
    watertight: bool
    filled: float
    untextured: float
    unseen: dict[str, float]
    voxel: float
    texture: int
    photos: int

    @property
    def text(self) -> str:
        """Describe the surface in one line."""
        sides = " x ".join(f"{side:.3g}" for side in self.size)
        whole = f"closed, volume {self.volume:.3g}" if self.volume is not None else "with holes"
        found = [f"{share:.0%} {side}" for side, share in self.unseen.items() if share >= LEAST]
        whole += f", not seen: {', '.join(found)}" if found else ""
        title = "Background" if self.box == run_files.SURROUNDINGS else f"Box '{self.box}'"
        return (
            f"{title}: {self.faces:,} faces, {sides} large, {whole};"
            f" {self.filled:.1%} filled, {self.untextured:.1%} without a photo's colour;"
            f" from {self.photos} photos."
        )


def read_surface(path: Path) -> SurfaceRecord | None:
    """Read the record of a surface; None if it is missing or damaged."""
    record = read_record(path)
    with suppress(KeyError, TypeError, ValueError, AttributeError, OverflowError):
        values = {field.name: record[field.name] for field in fields(SurfaceRecord)}
        found = SurfaceRecord(**values | {"size": tuple(values["size"])})
        return found if found.text else None
    return None


def add_to_reports(folder: Path) -> None:
    """Put a run's surfaces at the end of its reports, in place of what these say of them."""
    found = []
    with suppress(RunFolderError):  # a link: somebody who gets the report could not read it
        files = matching(own_folder(folder, run_files.FINE), f"*{RECORD}")
        read = ((file, read_surface(file)) for file in files if not is_link(file))
        found = [(file, record) for file, record in read if record is not None]
    title, caption = "Surfaces", "In clay, from four sides; unseen parts are orange."
    lines = [f"- {markdown_text(record.text)}" for _, record in found]
    put_section(folder / run_files.REPORT, title, [f"## {title}", "", *lines, ""] if found else [])
    parts = [f"<h2>{title}</h2>", f"<p>{caption}</p>"] if found else []
    for file, record in found:
        with suppress(OSError):
            data = read_bytes(file.with_suffix(".png"), opener=unlinked)
            if data.startswith(PNG):
                source = f"data:image/png;base64,{base64.b64encode(data).decode()}"
                parts.append(f'<p><img alt="" style="max-width: 100%" src="{source}"></p>')
        parts.append(f"<p>{html_text(record.text)}</p>")
    put_section(folder / run_files.REPORT_PAGE, title, parts, before="<script>")


def put_section(report: Path, title: str, lines: list[str], before: str = "") -> None:
    """Write a section into a report in place of its earlier version; empty lines remove it.

    A new one goes before the last `before`. Comments mark where it begins and ends. A report that
    is a link stays as it is.
    """
    start, end = f"<!-- {title.lower()} -->\n", f"<!-- end of {title.lower()} -->\n"
    try:
        text = read_bytes(report, most=None, opener=unlinked).decode()
    except (OSError, UnicodeError):
        return  # there is no report
    first = text.find(start)
    last = text.find(end, first) if first >= 0 else -1
    if last >= 0:
        text = text[: text.rfind(start, 0, last)] + text[last + len(end) :]
    place = text.rfind(before) if before in text else len(text)
    part = "".join(f"{line}\n" for line in lines)
    whole = f"{start}{part}{end}" if lines else ""
    write_text(report, text[:place] + whole + text[place:])
