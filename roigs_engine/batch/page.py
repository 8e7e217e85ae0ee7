"""`report.html` of a batch: every object in one table, with pictures and links to the runs."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from urllib.parse import quote

from ..errors import EngineError
from ..formats.files import matching, write_text
from ..formats.report_scores import scores_of_result
from ..formats.run_files import CROPS, FINE, REPORT_PAGE, RESULT
from ..formats.text import counted, duration
from ..formats.web_page import html_text, whole_page
from ..photos.headers import open_photo
from .engine_process import DONE, FAILED
from .schedule import SceneState

IsThere = Callable[[str], bool]
THUMBNAIL = 160  # pixels of the longer side
MOST_PIXELS = 50_000_000  # of a picture; pictures of runs have a few million
MOST_KEPT = 2000  # thumbnails, of about 4 KB each
COLUMNS = ("", "Scene", "Object", "State", "PSNR, dB", "SSIM", "Gaussians", "Training", "Files")
CLEAR = """\
th:nth-child(-n+4), td:nth-child(-n+4) { text-align: left; }
td img { display: block; max-height: 120px; }
.failed { color: #d33; white-space: normal; }"""


def write_batch_page(
    folder: Path, scenes: Iterable[SceneState], is_there: IsThere | None = None
) -> Path:
    """Write the page on all scenes; returns its path.

    `is_there`: whether a file of that name exists beside the page; None: look in the folder.
    """
    path = folder / REPORT_PAGE
    is_there = is_there or (lambda name: (folder / name).exists())
    # Failed scenes first: these need attention.
    ordered = sorted(scenes, key=lambda scene: scene.state != FAILED)
    write_text(path, _page(folder, ordered, is_there), durable=False)
    return path


def _page(folder: Path, scenes: Sequence[SceneState], is_there: IsThere) -> str:
    states = [scene.state for scene in scenes for _ in scene.plan.objects]
    done, failed = states.count(DONE), states.count(FAILED)
    title = f"{done} of {counted(len(states), 'object')} done"
    title += f", {failed} failed" if failed else ""
    heads = "".join(f"<th>{html_text(column)}</th>" for column in COLUMNS)
    rows = (row for scene in scenes for row in _rows(folder / scene.plan.name, scene, is_there))
    table = (f'<div class="wide"><table><tr>{heads}</tr>', *rows, "</table></div>")
    return whole_page(title, table, style=f"\n{CLEAR}")


def _rows(run: Path, scene: SceneState, is_there: IsThere) -> Iterator[str]:
    name, done = scene.plan.name, scene.state == DONE
    found = scores_of_result(run) if done else {}
    for box in scene.plan.objects:
        scores = found.get(box, {})
        cells = [
            _thumbnail(run / CROPS / box) if done else "",
            html_text(name),
            html_text(box),
            html_text(scene.state),
            _number(scores.get("roi_psnr"), "{:.2f}"),
            _number(scores.get("roi_ssim"), "{:.3f}"),
            _number(scores.get("gaussians_in_box"), "{:,}"),
            html_text(duration(scores["seconds"])) if "seconds" in scores else "",
            _links(name, box, is_there) if done else "",
        ]
        rest = ""
        if scene.state == FAILED:  # the reason takes the space of the missing numbers
            wide = f'<td class="failed" colspan="{len(cells) - 3}">'
            cells, rest = cells[:3], f"{wide}failed: {html_text(scene.reason)}</td>"
        yield "<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + f"{rest}</tr>"


def _links(scene: str, box: str, is_there: IsThere) -> str:
    """Links to the object's files that exist in the run folder."""
    names = {"report": REPORT_PAGE, "object": f"{FINE}/{box}.ply", "scene": RESULT}
    return " ".join(
        f'<a href="{html.escape(quote(f"{scene}/{name}"))}">{what}</a>'
        for what, name in names.items()
        if is_there(f"{scene}/{name}")
    )


def _thumbnail(crops: Path) -> str:
    found = matching(crops, "overview.png") or matching(crops, "*.png")
    try:
        return _small(found[0], found[0].stat().st_mtime_ns)
    except (IndexError, OSError):
        return ""


@lru_cache(maxsize=MOST_KEPT)
def _small(path: Path, _time: int) -> str:
    """A picture as an HTML element; cached, because the page is written many times."""
    try:
        with open_photo(path) as image:
            if image.width * image.height > MOST_PIXELS:
                return ""
            image.thumbnail((THUMBNAIL, THUMBNAIL))
            file = io.BytesIO()
            image.convert("RGB").save(file, "JPEG", quality=80)
    except (EngineError, MemoryError):
        return ""
    data = base64.b64encode(file.getvalue()).decode("ascii")
    return f'<img alt="" src="data:image/jpeg;base64,{data}">'


def _number(value: float | None, form: str) -> str:
    return "" if value is None else html_text(form.format(value))
