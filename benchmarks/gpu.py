"""Everything to measure on an NVIDIA GPU, unattended: `python -m benchmarks.gpu --out DIR`.

With ten minutes on a card:

    pip install torch==2.13.0 --index-url https://download.pytorch.org/whl/cu130
    pip install -e '.[train,dev]'                    # in the project's folder
    python -m benchmarks.gpu --out figures --minutes 10 --scene SCENE
    cat figures/summary.md                           # bring back the folder `figures`

SCENE is a COLMAP project with rois.json, and may be left out. `pip install gsplat==1.5.3` before it
adds gsplat's times, where there is a compiler (docs/cuda.md). With an hour, leave out `--minutes`.

The most valuable figures come first: is it right, how fast is a step, is it right in all cases, all
sizes, beside gsplat, a whole training. Each part is a separate process with a limit on its time,
and what it prints is in DIR at once: a part that fails, hangs or is killed costs only itself.
`DIR/summary.md` has how each ended, and its last lines.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path

from benchmarks.markdown import table

SAMPLE_SECONDS = 1
FIELDS = "timestamp,utilization.gpu,utilization.memory,memory.used,power.draw,temperature.gpu"
SHOWN_LINES = 40  # last lines of a part's output in the summary
SIZES = ("1280x853", "2048x1366")
COUNTS = (1_000_000, 100_000, 4_000_000)
LEAST_SECONDS = 5.0  # with less time left, no part is started


@dataclass(frozen=True, kw_only=True)
class Part:
    """One program.

    Attributes:
        name: name of its file in the output folder.
        command: arguments of Python.
        minutes: time limit.
    """

    name: str
    command: tuple[str, ...]
    minutes: float


@dataclass(frozen=True, kw_only=True)
class Ended:
    """The end of a part: `status` is its exit status, or the reason why there is none."""

    name: str
    status: str
    seconds: float


SHADERS = ("check-gpu", "--device", "gpu")
"""Checks the same GPU through Vulkan; needs the package wgpu."""


def parts(scene: Path | None, out: Path, *, gsplat: bool) -> list[Part]:
    """The measurements, the most valuable first.

    Args:
        scene: the scene to train; None: nothing is trained.
        out: the output folder.
        gsplat: whether gsplat is installed; then it is compiled and also measured.
    """
    tests = ("-m", "pytest", "-q", "-rs", "-m", "cuda", "tests/engine/cuda/test_cuda.py")
    first, *others = [(count, size) for size in SIZES for count in COUNTS]
    found = [
        Part(name="check-gpu", command=("-m", "roigs_engine", "check-gpu"), minutes=3),
        _step(*first, alone=True),
        Part(name="tests", command=tests, minutes=4),
        *(_step(*row, alone=True) for row in others),
        Part(name="shaders", command=("-m", "roigs_engine", *SHADERS), minutes=2),
        Part(name="first-use", command=("-m", "benchmarks.first_use", "--rounds", "1"), minutes=2),
    ]
    if gsplat:
        code = "import gsplat.cuda._backend as built; assert built._C"
        found.append(Part(name="gsplat-compiles", command=("-c", code), minutes=15))
        found += [_step(*row, alone=False) for row in (first, *others)]
    if scene is not None:
        found += [_paper(scene, out, "paper-tenth", ("--steps-factor", "0.1"), 30)]
        found += [_paper(scene, out, "paper", (), 240)]
    return found


def _step(count: int, size: str, *, alone: bool) -> Part:
    row = ("--device", "cuda", "--gaussians", str(count), "--size", size)
    name = f"step-{count // 1000}k-{size}{'' if alone else '-gsplat'}"
    command = ("-m", "benchmarks.step", *row, *(("--alone",) if alone else ()))
    return Part(name=name, command=command, minutes=4)


def _paper(scene: Path, out: Path, name: str, more: tuple[str, ...], minutes: float) -> Part:
    run = ("-m", "roigs_engine", "run", str(scene), "--rois", str(scene / "rois.json"))
    options = ("--preset", "paper", "--device", "cuda", "--run-dir", str(out / name))
    return Part(name=name, command=(*run, *options, *more), minutes=minutes)


def do(part: Part, out: Path, most: float = float("inf")) -> Ended:
    """Run a part for at most `most` seconds; its output goes to a file."""
    started = time.monotonic()
    limit = min(60 * part.minutes, most)
    said = f"ended after {limit / 60:.1f} minutes"
    try:
        with open(out / f"{part.name}.txt", "wb") as file, watched(out / f"{part.name}.csv"):
            process = subprocess.Popen(
                [sys.executable, *part.command],
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONUNBUFFERED": "1"},  # keeps the output of a crash
            )
            try:
                said = str(process.wait(limit))
            except subprocess.TimeoutExpired:
                pass
            finally:
                process.kill()
                process.wait()
    except OSError as error:
        said = f"not started ({error})"
    return Ended(name=part.name, status=said, seconds=round(time.monotonic() - started, 1))


@contextmanager
def watched(path: Path) -> Iterator[None]:
    """Let nvidia-smi write the GPU's load to a file meanwhile, if it is installed."""
    program = shutil.which("nvidia-smi")
    if program is None:
        yield
        return
    query = [program, f"--query-gpu={FIELDS}", "--format=csv", "-l", str(SAMPLE_SECONDS)]
    with open(path, "wb") as file:
        try:
            process = subprocess.Popen(query, stdout=file, stderr=subprocess.DEVNULL)
        except OSError:
            yield
            return
        try:
            yield
        finally:
            process.terminate()
            process.wait()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the parts; returns 0 if the exit status of all is 0."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for the figures")
    parser.add_argument("--scene", type=Path, help="a COLMAP project with rois.json, to train on")
    parser.add_argument("--only", nargs="+", metavar="PART", help="these parts alone")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="for all of it")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    end, ended = time.monotonic() + 60 * options.minutes, []
    for part in parts(options.scene, options.out, gsplat=find_spec("gsplat") is not None):
        if options.only and part.name not in options.only:
            continue
        left = end - time.monotonic()
        print(part.name, file=sys.stderr)
        if left < LEAST_SECONDS:
            ended.append(Ended(name=part.name, status="no time left", seconds=0.0))
        else:
            ended.append(do(part, options.out, left))
        with suppress(OSError):  # a full disk
            write(ended, options.out)  # after each part, in case the run is interrupted
    return int(any(part.status != "0" for part in ended))


def write(ended: Sequence[Ended], out: Path) -> None:
    """Write `summary.json` and `summary.md`."""
    records = [asdict(part) for part in ended]
    (out / "summary.json").write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")
    rows = [(part.name, part.status, f"{part.seconds:.1f}") for part in ended]
    lines = table(("part", "exit status", "seconds"), rows)
    for part in ended:
        lines += ["", f"## {part.name}", "", *_last_lines(out / f"{part.name}.txt")]
    (out / "summary.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _last_lines(path: Path) -> list[str]:
    """The last lines of a part's output; of a progress bar, its last state."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return []
    lines = [line.rpartition("\r")[2].rstrip() for line in text.rstrip().split("\n")]
    return [line for line in lines[-SHOWN_LINES:] if line]


if __name__ == "__main__":
    sys.exit(main())
