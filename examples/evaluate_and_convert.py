"""Measures and converts a result: python examples/evaluate_and_convert.py SCENE ROIS RUN_DIR OUT"""

import sys
from pathlib import Path
from typing import Any

from roigs_engine import Convert, Evaluate, convert, evaluate
from roigs_engine.formats.stage_list import read_stage_list


def main(scene: Path, rois: Path, run_dir: Path, out: Path, **options: Any) -> str:
    """Compare a run's result with its first stage on test photos; returns the table.

    The result is also written as `out`/result.glb, for other programs.
    """
    first = read_stage_list(run_dir)["scene"] / "model.ply"
    models = (f"Scene-GS={first}", f"Ours={run_dir / 'result.ply'}")
    request = Evaluate(scene=scene, rois=rois, model=models, out=out, **options)
    table = evaluate(request).table
    convert(Convert(source=run_dir / "result.ply", out=out / "result.glb"))
    return table


if __name__ == "__main__":
    print(main(*map(Path, sys.argv[1:5])))
