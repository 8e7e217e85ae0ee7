"""Everything to measure on an NVIDIA GPU, unattended: `python -m benchmarks.gpu --out DIR`.

Each part is a process of its own with a limit on its time. What it prints is in DIR; a part that
fails does not stop the others. `DIR/summary.md` says how each ended.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.markdown import table

SAMPLE_SECONDS = 2
FIELDS = "timestamp,utilization.gpu,utilization.memory,memory.used,power.draw,temperature.gpu"


@dataclass(frozen=True, kw_only=True)
class Part:
    """One program.

    Attributes:
        name: of its file in the output folder.
        command: after the name of Python.
        minutes: after which it is ended.
    """

    name: str
    command: tuple[str, ...]
    minutes: float


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a part ended: `status` is its exit status, or why there is none."""

    name: str
    status: str
    seconds: float


def parts(scene: Path | None, out: Path) -> list[Part]:
    """What is measured, the short parts first."""
    small = ("--gaussians", "100000", "--size", "1280x853")
    found = [
        Part(name="check-gpu", command=("-m", "roigs_engine", "check-gpu"), minutes=3),
        Part(
            name="tests",
            command=("-m", "pytest", "-q", "-rs", "-m", "cuda", "tests/engine/cuda/test_cuda.py"),
            minutes=10,
        ),
        Part(
            name="step-small",
            command=("-m", "benchmarks.step", "--device", "cuda", *small),
            minutes=5,
        ),
        Part(name="step", command=("-m", "benchmarks.step", "--device", "cuda"), minutes=20),
    ]
    if scene is not None:
        run = ("-m", "roigs_engine", "run", str(scene), "--rois", str(scene / "rois.json"))
        options = ("--preset", "paper", "--device", "cuda", "--run-dir", str(out / "run"))
        found.append(Part(name="paper", command=(*run, *options), minutes=240))
    return found


def do(part: Part, out: Path) -> Ended:
    """Run a part; its output goes to a file."""
    started = time.monotonic()
    with open(out / f"{part.name}.txt", "wb") as file, watched(out / f"{part.name}.csv"):
        try:
            status = subprocess.run(
                [sys.executable, *part.command],
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                timeout=60 * part.minutes,
                check=False,
            ).returncode
            said = str(status)
        except subprocess.TimeoutExpired:
            said = f"ended after {part.minutes:g} minutes"
    return Ended(name=part.name, status=said, seconds=round(time.monotonic() - started, 1))


@contextmanager
def watched(path: Path) -> Iterator[None]:
    """Meanwhile nvidia-smi, where it is installed, writes how busy the GPU is."""
    program = shutil.which("nvidia-smi")
    if program is None:
        yield
        return
    query = [program, f"--query-gpu={FIELDS}", "--format=csv", "-l", str(SAMPLE_SECONDS)]
    with open(path, "wb") as file:
        process = subprocess.Popen(query, stdout=file, stderr=subprocess.DEVNULL)
        try:
            yield
        finally:
            process.terminate()
            process.wait()


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit status: 0 if every part ended with 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for the figures")
    parser.add_argument("--scene", type=Path, help="a COLMAP project with rois.json, to train on")
    parser.add_argument("--only", nargs="+", metavar="PART", help="these parts alone")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    ended = []
    for part in parts(options.scene, options.out):
        if options.only and part.name not in options.only:
            continue
        print(part.name, file=sys.stderr)
        ended.append(do(part, options.out))
        write(ended, options.out)  # so that an interrupted run leaves what it has
    return int(any(part.status != "0" for part in ended))


def write(ended: Sequence[Ended], out: Path) -> None:
    """`summary.json` and `summary.md`."""
    records = [asdict(part) for part in ended]
    (out / "summary.json").write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")
    rows = [(part.name, part.status, f"{part.seconds:.1f}") for part in ended]
    lines = table(("part", "exit status", "seconds"), rows)
    (out / "summary.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
