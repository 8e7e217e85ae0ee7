"""One process that measures one row; step.py starts it and asks it by lines of text.

Its argument is JSON, see `main`. Every line it reads, a key of `answers`, it answers with a line of
JSON. Processes that are asked in turns are compared fairly: what slows the machine slows them all.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import torch

from benchmarks.flops import peak_gflops
from benchmarks.measure import StepBenchmark, forget_peak_memory, peak_memory
from roigs_engine.kernels import library


def main() -> None:
    """Answer questions until the input ends."""
    job = json.loads(sys.argv[1])
    torch.set_num_threads(1)
    library.set_threads(job["threads"])
    benchmark = StepBenchmark(job["gaussians"], job["width"], job["height"])
    peak_library = Path(job["peak_libraries"][library.isa()])
    forget_peak_memory()  # exclude the scene's creation
    answers = {
        "isa": library.isa,
        "counts": benchmark.counts,
        "step": benchmark.step_times,
        "extras": benchmark.extras_times,
        "peak": lambda: peak_gflops(peak_library),
        "memory": peak_memory,
    }
    for line in sys.stdin:
        print(json.dumps(answers[line.strip()]()), flush=True)


if __name__ == "__main__":
    main()
