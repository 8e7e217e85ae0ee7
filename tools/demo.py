"""The demo: the demo scene through the Blender add-on, then measured by the engine.

    python tools/demo.py RUN_DIR [--steps-factor F]

First the headless example of the add-on (import, boxes, photos, training, picture, .blend), then
`roigs_engine run` on the same run folder, which finds the training done, trains the baselines and
writes the table. Without bpy, the engine does it all alone. Run it with the engine's Python.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
from pathlib import Path

import blender_module

SCENE = Path("demo/scene")
EXAMPLE = "roigs_addon/examples/headless.py"
BASELINES = ("full-scene", "full-scene-tuned")


def call(command: list[str], variables: dict[str, str] | None = None) -> int:
    """Run a program in the project's folder; returns its exit status. It also gets Ctrl-C."""
    with subprocess.Popen(command, cwd=blender_module.ROOT, env=variables) as process:
        return process.wait()


def main() -> int:
    """Run the demo; returns the exit status of the first command that fails, or 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("run_dir", type=Path, help="folder of the results")
    parser.add_argument("--steps-factor", default="1", help="times the steps of the preset")
    options = parser.parse_args()
    run_dir, factor = str(options.run_dir), ["--steps-factor", options.steps_factor]
    rois = ["--rois", str(SCENE / "rois.json")]
    engine = [sys.executable, "-m", "roigs_engine", "run"]
    compare = ["--compare", *BASELINES]
    try:
        blender = blender_module.working_python()
    except blender_module.NoBlenderError as error:
        print(f"note: without Blender, the engine alone: {error}", flush=True)
        preset = ["--preset", "draft", *factor]
        return call([*engine, str(SCENE), *rois, *preset, *compare, "--run-dir", run_dir])

    # From here on, Ctrl-C stops only the running program, which saves its work; then this script
    # ends.
    signal.signal(signal.SIGINT, lambda *_: None)
    status = call(
        [
            *(str(blender), EXAMPLE, "--colmap", str(SCENE), *rois, "--out", run_dir),
            *("--test-every", "8", *factor),
        ],
        blender_module.variables() | {"ROIGS_ENGINE_PYTHON": sys.executable},
    )
    if status:
        return status
    request = str(Path(run_dir) / "blender" / "train.json")
    status = call([*engine, request, *compare, "--run-dir", run_dir])
    if status == 0:
        for what, where in (("Blender", "scene.blend"), ("rendered", "picture.png")):
            print(f"{what + ':':10}{options.run_dir / where}")
    return status


if __name__ == "__main__":
    sys.exit(main())
