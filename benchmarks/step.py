"""Time of a training step: `python -m benchmarks.step` (nothing else should run meanwhile).

Every row is measured in a separate process; where engines or instruction sets are compared, their
processes take turns, one round each. benchmarks/README.md explains the options and the tables.
"""

from __future__ import annotations

import argparse
import platform
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict
from itertools import product
from pathlib import Path

import torch

from benchmarks import cuda_step, tables
from benchmarks.flops import peak_libraries
from benchmarks.results import Measurement, Row
from benchmarks.variants import Variant, Worker, engines
from roigs_engine.cuda.device import choose_device
from roigs_engine.machine import usable_cores

DEFAULTS = {
    "cpu": ([50_000, 200_000, 1_000_000], [(480, 320), (1280, 853)]),
    "cuda": ([100_000, 1_000_000, 4_000_000], [(1280, 853), (2048, 1366)]),
}
"""Default rows: numbers of Gaussians, sizes of the picture."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and print tables in Markdown; progress goes to standard error."""
    options = _options(arguments)
    if options.device == "cuda":
        _on_gpu(options)
        return
    rows = [
        Row(gaussians, width, height, threads)
        for gaussians, (width, height), threads in product(
            options.gaussians, options.size, options.threads
        )
    ]
    question = "extras" if options.extras else "step"
    measurements: list[Measurement] = []
    with engines(options.compare) as folders, peak_libraries() as peaks:
        variants = [Variant(*engine, isa) for engine, isa in product(folders.items(), options.isa)]
        for row in rows:
            print(row, file=sys.stderr)
            measurements += measure(row, variants, peaks, question, options.rounds)

    print(f"{platform.machine()}, {usable_cores()} cores, {options.rounds} rounds")
    if options.extras:
        _section("Render (raster stage) with optional outputs, relative to without, CPU time")
        print(tables.extras_table(measurements))
        return
    _section("Milliseconds, wall (CPU)")
    print(tables.stage_table(measurements))
    _section("Work per image, time per pair evaluation, share of one core's FMA peak")
    print(tables.work_table(measurements))
    _section("Growth of the step with visible Gaussians and pair evaluations (from three rows on)")
    print(tables.growth_table(measurements))
    if len(variants) > 1:
        first = measurements[0]
        _section(f"Medians relative to those of {first.engine} {first.isa}, CPU (wall)")
        print(tables.ratio_table(measurements))


def _on_gpu(options: argparse.Namespace) -> None:
    """Print the table of `cuda_step`."""
    device = choose_device("cuda")
    rows = []
    for gaussians, size in product(options.gaussians, options.size):
        print(gaussians, *size, file=sys.stderr)
        makers = (cuda_step.our_step,) if options.alone else None
        rows.append(cuda_step.measure(gaussians, size, options.rounds, device, makers))
    print(f"{torch.cuda.get_device_name(device)}, torch {torch.__version__}")
    _section("Milliseconds a step; share of it inside kernels, waits for the GPU in one step")
    print(cuda_step.table(rows))


def measure(
    row: Row,
    variants: Sequence[Variant],
    peak_libraries: dict[str, Path],
    question: str,
    rounds: int,
) -> list[Measurement]:
    """Measure a row in all variants, in turn; `question`: "step" or "extras"."""
    peaks = {isa: str(path) for isa, path in peak_libraries.items()}
    job = {**asdict(row), "peak_libraries": peaks}
    with ExitStack() as stack:
        workers = [Worker(variant, job) for variant in variants]
        for worker in workers:
            stack.callback(worker.close)
        measurements = [
            Measurement(row, v.name, worker.ask("isa"), worker.ask("counts"))
            for v, worker in zip(variants, workers, strict=True)
        ]
        for worker in workers:
            worker.ask(question)  # memory is new, caches are cold
        for _ in range(rounds):
            for m, worker in zip(measurements, workers, strict=True):
                m.peak = max(m.peak, worker.ask("peak"))
                (m.rounds if question == "step" else m.extras).append(worker.ask(question))
        for m, worker in zip(measurements, workers, strict=True):
            m.memory = worker.ask("memory")
    return measurements


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="cpu")
    cores = usable_cores()
    threads = [1, cores] if cores > 1 else [1]
    parser.add_argument("--gaussians", type=int, nargs="+", metavar="N")
    parser.add_argument("--size", type=_size, nargs="+", metavar="WxH")
    parser.add_argument("--threads", type=int, nargs="+", default=threads, metavar="N")
    parser.add_argument("--rounds", type=int, default=5, help="passes over the cameras (5)")
    parser.add_argument("--isa", nargs="+", default=[""], help="instruction sets, taking turns")
    parser.add_argument("--compare", metavar="REV", help="git revision to take turns with")
    parser.add_argument("--extras", action="store_true", help="optional outputs, not steps")
    parser.add_argument("--alone", action="store_true", help="on a GPU: not beside gsplat")
    options = parser.parse_args(arguments)
    counts, sizes = DEFAULTS[options.device]
    options.gaussians, options.size = options.gaussians or counts, options.size or sizes
    return options


def _size(text: str) -> tuple[int, int]:
    width, height = text.lower().split("x")
    return int(width), int(height)


def _section(title: str) -> None:
    print(f"\n{title}:\n")


if __name__ == "__main__":
    main()
