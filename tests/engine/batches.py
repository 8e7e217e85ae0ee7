"""A batch of two scenes, and run folders compared byte by byte."""

from __future__ import annotations

import json
from pathlib import Path

from tests.engine.killing import timeless

HEAD = """\
[defaults]
steps-factor = 0.003
test-every = 4
device = "cpu"
outputs = ["compressed.ply"]
"""

NO_BYTES = {"events.jsonl", "provenance.json", "report.md", "report.html", "settings.json"}


def box(name: str, low: float, high: float) -> dict[str, object]:
    return {"name": name, "min": [low] * 3, "max": [high] * 3}


def table_of(folder: Path, scans: Path, *, high: float = 0.5, seed: int = 0) -> Path:
    """The table: a scene that is split, and one that is a single part."""
    boxes = {
        "hall": [box("vase", -0.5, high), box("lamp", -0.9, 0.1)],
        "attic": [box("jar", -1, 1)],
    }
    for name, rois in boxes.items():
        (folder / f"{name}.json").write_text(json.dumps({"rois": rois}), encoding="utf-8")
    rows = [
        f"[scenes.{name}]\nscene = '{scans / name}'\nrois = '{name}.json'\nseed = {seed}\n{more}"
        for name, more in (("hall", "strategy = 'independent'\n"), ("attic", ""))
    ]
    path = folder / "museum.toml"
    path.write_text("\n".join([HEAD, *rows]), encoding="utf-8")
    return path


def contents(folder: Path) -> dict[str, object]:
    """File -> what it holds, without times."""
    files = [p for p in folder.rglob("*") if p.is_file() and p.name not in NO_BYTES]
    return {
        str(p.relative_to(folder)): timeless(json.loads(p.read_bytes()))
        if p.suffix == ".json" and p.name != "photos.json"
        else p.read_bytes()
        for p in files
        if p.name != "photos.json"
    }
