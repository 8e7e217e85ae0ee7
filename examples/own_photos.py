"""Trains on a list of photos of your own: python examples/own_photos.py SCENE ROIS RUN_DIR"""

import json
import sys
from pathlib import Path
from typing import Any

from roigs_engine import Select, Train, select, train


def main(scene: Path, rois: Path, run_dir: Path, **options: Any) -> Path | None:
    """Select photos of each box, change the lists, and train on them; returns the PLY."""
    lists = run_dir.with_name(f"{run_dir.name}-photos")
    selected = select(Select(scene=scene, rois=rois, count=8, out=lists))
    for path in selected.files.values():
        record = json.loads(path.read_text(encoding="utf-8"))
        record["names"] = record["names"][:-1]  # whatever you know better
        path.write_text(json.dumps(record), encoding="utf-8")
    request = Train(scene=scene, rois=rois, selection=lists, run_dir=run_dir, **options)
    return train(request).result


if __name__ == "__main__":
    print(main(*map(Path, sys.argv[1:4])))
