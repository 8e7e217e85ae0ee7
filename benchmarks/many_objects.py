"""A batch of very many, very small objects: whether it ends, and the memory of its driver.

    python -m benchmarks.many_objects --out DIR [--objects 200] [--jobs 2 | --cluster local]

Each object is a scene of its own with 10 photos of 96 x 72 pixels, trained for a few steps. The
memory is sampled from `/proc`, so this needs Linux. All samples are in DIR/memory.json.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.markdown import table
from benchmarks.tiny_scene import BOX, write_scene
from roigs_engine.formats.run_files import REPORT_PAGE

EVERY = 2.0  # seconds between two samples
DEFAULTS = f"""\
[defaults]
scene = "scene"
roi = ["{BOX}"]
steps_factor = 0.001
test_every = 5
device = "cpu"
"""
HEAD = ("objects", "seconds", "driver at half, MB", "at the end", "growth", "rows", "load")


def write_table(folder: Path, objects: int) -> Path:
    """Write a table that repeats a small scene, each time with its own seed; returns its path."""
    write_scene(folder / "scene")
    rows = [f"[scenes.small-{seed:03}]\nseed = {seed}" for seed in range(objects)]
    path = folder / "museum.toml"
    path.write_text("\n".join([DEFAULTS, *rows]), encoding="utf-8")
    return path


def memory(process: int) -> float:
    """Resident memory of a process now, MB; 0: it has ended."""
    try:
        text = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    except OSError:
        return 0.0
    rows = dict(line.split(":", 1) for line in text.splitlines() if ":" in line)
    return int(rows["VmRSS"].split()[0]) / 1024 if "VmRSS" in rows else 0.0


def sampled(command: list[str]) -> list[tuple[float, float, int]]:
    """Run a batch; returns samples of (seconds, megabytes, objects done)."""
    found: list[tuple[float, float, int]] = []
    began, done = time.monotonic(), 0
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as batch:
        assert batch.stdout is not None
        for line in batch.stdout:
            event = json.loads(line)
            if event["event"] == "failed":
                print(event["message"], file=sys.stderr)
            if event.get("stage") == "batch":
                done = event["step"]
            seconds = time.monotonic() - began
            if not found or seconds - found[-1][0] > EVERY:
                found.append((round(seconds, 1), round(memory(batch.pid), 1), done))
    if batch.returncode:
        sys.exit(batch.returncode)
    return found


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--objects", type=int, default=200)
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--jobs", type=int, default=2)
    where.add_argument("--cluster")
    args = parser.parse_args()
    out = args.out.absolute()
    how = ["--cluster", args.cluster] if args.cluster else ["--jobs", str(args.jobs)]
    path = write_table(out, args.objects)
    command = [sys.executable, "-m", "roigs_engine", "batch", str(path), *how, "--events"]
    found = sampled([*command, "--run-dir", str(out / "runs")])
    (out / "memory.json").write_text(json.dumps(found), encoding="utf-8")
    work = [row for row in found if row[1] and row[2]]
    half = next(row for row in work if row[2] >= args.objects / 2)
    growth = work[-1][1] / half[1] - 1
    page = (out / "runs" / REPORT_PAGE).read_text(encoding="utf-8")
    cells = [
        f"{args.objects}, {' '.join(how)}",
        f"{found[-1][0]:.0f}",
        f"{half[1]:.0f}",
        f"{work[-1][1]:.0f}",
        f"{100 * growth:+.1f} %",
        str(page.count("<tr>") - 1),
        f"{os.getloadavg()[0]:.1f}",
    ]
    print("\n".join(table(HEAD, [cells])))


if __name__ == "__main__":
    main()
