"""Trains the object that most photos show: python examples/train_box.py SCENE RUN_DIR"""

import sys
from pathlib import Path
from typing import Any

from roigs_engine import Context, Train, train


def main(scene: Path, run_dir: Path, **options: Any) -> Path | None:
    """Train a COLMAP project, or photos, with a box around the object; returns the PLY.

    Args:
        scene: the folder of the project or of the photos.
        run_dir: gets the result, and a checkpoint: the same call resumes.
        options: other fields of the request, such as `preset` or `max_side`.
    """
    request = Train(scene=scene, roi=("auto",), run_dir=run_dir, **options)
    return train(request, Context(emit=print)).result


if __name__ == "__main__":
    print(main(*map(Path, sys.argv[1:3])))
