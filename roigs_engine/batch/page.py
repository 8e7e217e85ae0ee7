"""`report.html` of a batch: every object in one table, with pictures and links to the runs."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ..errors import EngineError
from ..evaluation.report_html import STYLE
from ..formats.files import matching, read_json, write_text
from ..formats.run_files import CROPS, FINE, REPORT_DATA, REPORT_PAGE, RESULT
from ..formats.text import counted, printable
from .board import duration
from .engine_process import DONE, FAILED
from .schedule import SceneState

IsThere = Callable[[str], bool]
THUMBNAIL = 160  # pixels of the longer side
MOST_KEPT = 2000  # of about 4 KB each
COLUMNS = ("", "Scene", "Object", "State", "PSNR, dB", "SSIM", "Gaussians", "Training", "Files")
CLEAR = """\
th:nth-child(-n+4), td:nth-child(-n+4) { text-align: left; }
td img { display: block; max-height: 120px; }
.failed { color: #d33; white-space: normal; }"""


@dataclass(frozen=True, kw_only=True)
class ObjectRow:
    """An object's row: texts, and the row of its run's report."""

    scene: str
    name: str
    state: str
    reason: str
    scores: dict[str, Any]


def write_batch_page(
    folder: Path, scenes: Iterable[SceneState], is_there: IsThere | None = None
) -> Path:
    """Write the page over all scenes; returns its path.

    Args:
        folder: of the batch.
        scenes: how far they are.
        is_there: whether there is a file of that name beside the page; None: look in the folder.

    Raises:
        RunFolderError: it cannot be written.
    """
    path = folder / REPORT_PAGE
    rows = [row for scene in scenes for row in _rows(folder, scene)]
    rows.sort(key=lambda row: row.state != FAILED)  # first what somebody has to look at
    is_there = is_there or (lambda name: (folder / name).exists())
    write_text(path, _page(folder, rows, is_there), durable=False)
    return path


def result_scores(run: Path) -> dict[str, dict[str, Any]]:
    """Box -> the row of the result in a run's report; empty if there is none."""
    try:
        report = read_json(run / REPORT_DATA)
        return {box["roi"]: box["rows"][-1] for box in report["rois"] if box["rows"]}
    except (EngineError, KeyError, TypeError, IndexError):
        return {}


def _rows(folder: Path, scene: SceneState) -> list[ObjectRow]:
    found = result_scores(folder / scene.plan.name) if scene.state == DONE else {}
    return [
        ObjectRow(
            scene=scene.plan.name,
            name=name,
            state=scene.state,
            reason=scene.reason,
            scores=found.get(name, {}),
        )
        for name in scene.plan.objects
    ]


def _page(folder: Path, rows: Sequence[ObjectRow], is_there: IsThere) -> str:
    done = sum(row.state == DONE for row in rows)
    failed = sum(row.state == FAILED for row in rows)
    title = f"{done} of {counted(len(rows), 'object')} done"
    title += f", {failed} failed" if failed else ""
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    heads = "".join(f"<th>{_text(column)}</th>" for column in COLUMNS)
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
        f"<title>{_text(title)}</title>",
        f"<style>{STYLE}\n{CLEAR}</style>",
        f"<h1>{_text(title)}</h1>",
        f'<div class="wide"><table><tr>{heads}</tr>',
        *(_row(folder, row, is_there) for row in rows),
        "</table></div>",
        "</html>",
        "",
    ]
    return "\n".join(parts)


def _row(folder: Path, row: ObjectRow, is_there: IsThere) -> str:
    scores = row.scores
    if row.state == FAILED:  # its reason has the room of the numbers that it lacks
        rest = f'<td class="failed" colspan="{len(COLUMNS) - 3}">failed: {_text(row.reason)}</td>'
        return f"<tr><td></td><td>{_text(row.scene)}</td><td>{_text(row.name)}</td>{rest}</tr>"
    cells = [
        _thumbnail(folder / row.scene / CROPS / row.name) if row.state == DONE else "",
        _text(row.scene),
        _text(row.name),
        _text(row.state),
        _number(scores.get("roi_psnr"), "{:.2f}"),
        _number(scores.get("roi_ssim"), "{:.3f}"),
        _number(scores.get("gaussians_in_box"), "{:,}"),
        _text(duration(scores["seconds"])) if _is_number(scores.get("seconds")) else "",
        _links(row, is_there) if row.state == DONE else "",
    ]
    return "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"


def _links(row: ObjectRow, is_there: IsThere) -> str:
    """Links to what the object's run folder has."""
    names = {"report": REPORT_PAGE, "object": f"{FINE}/{row.name}.ply", "scene": RESULT}
    found = {what: f"{row.scene}/{name}" for what, name in names.items()}
    return " ".join(
        f'<a href="{html.escape(quote(name))}">{what}</a>'
        for what, name in found.items()
        if is_there(name)
    )


def _thumbnail(crops: Path) -> str:
    """One of the run's pictures, small."""
    found = matching(crops, "overview.png") or matching(crops, "*.png")
    try:
        return _small(found[0], found[0].stat().st_mtime_ns)
    except (IndexError, OSError):
        return ""


@lru_cache(maxsize=MOST_KEPT)
def _small(path: Path, _time: int) -> str:
    """A picture as an element of a page; kept, as the page is written again and again."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            image.thumbnail((THUMBNAIL, THUMBNAIL))
            file = io.BytesIO()
            image.convert("RGB").save(file, "JPEG", quality=80)
    except (OSError, ValueError):
        return ""
    data = base64.b64encode(file.getvalue()).decode("ascii")
    return f'<img alt="" src="data:image/jpeg;base64,{data}">'


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _number(value: Any, form: str) -> str:
    return _text(form.format(value)) if _is_number(value) else ""


def _text(text: str) -> str:
    return html.escape(printable(" ".join(text.split())))
