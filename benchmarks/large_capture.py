"""A capture of thousands of large photos: `python -m benchmarks.large_capture FOLDER` (Linux).

Writes JPEG photos of a distorted camera, all different files of a few pictures, and runs the whole
engine on them: checks, undistortion, short training, evaluation. Prints seconds and the peak of
resident memory (the kernel's VmHWM) of each stage. 2,000 photos of 24 megapixels take about 5 GB of
disk, and their undistorted copies with `--max-side 2000` about as much.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.markdown import table

PICTURES = 5  # different ones; the others are copies with a few different bytes at the end
POINTS = 5000


def write_scene(folder: Path, count: int, width: int, height: int) -> None:
    """Write a COLMAP project of `count` photos on a ring around a cloud of points."""
    rng = np.random.default_rng(0)
    (folder / "images").mkdir(parents=True, exist_ok=True)
    for k in range(PICTURES):
        coarse = Image.fromarray(rng.integers(0, 256, (height // 20, width // 20, 3), np.uint8))
        coarse.resize((width, height)).save(folder / f"picture-{k}.jpg", quality=90)
    pictures = [(folder / f"picture-{k}.jpg").read_bytes() for k in range(PICTURES)]
    poses = []
    for k in range(count):
        (folder / f"images/{k:05d}.jpg").write_bytes(pictures[k % PICTURES] + b"%05d" % k)
        half = np.pi * k / count  # half of the angle about the vertical axis
        pose = f"{np.cos(half):.9f} 0 {np.sin(half):.9f} 0 0 0 4"
        poses.append(f"{k + 1} {pose} 1 {k:05d}.jpg\n\n")
    model = folder / "sparse/0"
    model.mkdir(parents=True, exist_ok=True)
    lens = f"1 SIMPLE_RADIAL {width} {height} {width} {width / 2} {height / 2} 0.05\n"
    (model / "cameras.txt").write_text(lens, encoding="ascii")
    (model / "images.txt").write_text("".join(poses), encoding="ascii")
    lines = [
        f"{k + 1} {x:.6f} {y:.6f} {z:.6f} 128 128 128 0.5\n"
        for k, (x, y, z) in enumerate(rng.uniform(-1, 1, (POINTS, 3)))
    ]
    (model / "points3D.txt").write_text("".join(lines), encoding="ascii")


class Peaks:
    """Seconds and peak memory of the stages of a process, from its events."""

    def __init__(self, process: int) -> None:
        self.rows: list[tuple[str, float, float]] = []
        self._folder = Path(f"/proc/{process}")
        self._stage, self._since = "load", time.monotonic()
        self._peak = 0.0

    def event(self, event: dict[str, Any]) -> None:
        """Take an event; a stage ends when the next one begins."""
        with suppress(OSError, StopIteration):  # the process may have ended
            self._peak = self._read_peak()
        if event["event"] in ("stagestarted", "done", "failed"):
            seconds = time.monotonic() - self._since
            self.rows.append((self._stage, seconds, self._peak))
            print(f"{self._stage}: {seconds:.1f} s, {self._peak:.0f} MiB", flush=True)
            self._stage, self._since = str(event.get("stage", "")), time.monotonic()
            with suppress(OSError):
                (self._folder / "clear_refs").write_text("5", encoding="ascii")  # resets the peak
        elif event["event"] == "message":
            print(event["text"], flush=True)

    def _read_peak(self) -> float:
        """Peak resident memory, MiB."""
        lines = (self._folder / "status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def main() -> int:
    """Write the scene unless it exists, run the engine, print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="folder to work in")
    parser.add_argument("--photos", type=int, default=2000)
    parser.add_argument("--size", type=int, nargs=2, default=(6000, 4000), metavar=("W", "H"))
    parser.add_argument("--max-side", type=int, default=2000)
    parser.add_argument("--image-cache", type=float, default=500, metavar="MB")
    parser.add_argument("--steps-factor", type=float, default=0.02)
    args = parser.parse_args()
    scene = args.folder / "scene"
    if not (scene / "sparse").exists():
        write_scene(scene, args.photos, *args.size)
    command = [sys.executable, "-m", "roigs_engine", "run", scene, "--run-dir", args.folder / "run"]
    command += ["--roi", "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5", "--device", "cpu", "--events"]
    for option in ("max_side", "image_cache", "steps_factor"):
        command += ["--" + option.replace("_", "-"), getattr(args, option)]
    words = [str(word) for word in command]
    pipe = subprocess.PIPE
    with subprocess.Popen(
        words, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None
        peaks = Peaks(process.pid)
        for line in process.stdout:
            peaks.event(json.loads(line))
    rows = [(stage, f"{seconds:.1f}", f"{peak:.0f}") for stage, seconds, peak in peaks.rows]
    print("\n".join(table(("stage", "seconds", "peak, MiB"), rows, names=1)))
    return process.returncode


if __name__ == "__main__":
    sys.exit(main())
