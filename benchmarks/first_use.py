"""Time of the CUDA kernels at first and later uses: `python -m benchmarks.first_use`.

It needs NVRTC (`pip install nvidia-cuda-nvrtc`, or torch for CUDA) and no GPU: everything up to the
calls of the driver is timed, each time in a new process with a folder of its own as the cache.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from benchmarks.markdown import table
from roigs_engine.machine import usable_cores

CAPABILITIES = (75, 89, 90, 120)
CODE = """
import json, sys, time
import torch
from pathlib import Path
started = time.perf_counter()
from roigs_engine.cuda import compiler
compiler.user_cache = lambda: Path(sys.argv[2])
nvrtc = compiler.load()
nvrtc.architectures()
code = compiler.machine_code(nvrtc, int(sys.argv[1]))
print(json.dumps([time.perf_counter() - started, len(code), nvrtc.version]))
"""
"""The work of a training before it calls the driver. torch is imported before the time starts."""


def measure(capability: int, cache: Path) -> tuple[float, int, str]:
    """Measure in a new process: seconds, bytes of machine code, and the version of NVRTC."""
    command = [sys.executable, "-c", CODE, str(capability), str(cache)]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    seconds, size, version = json.loads(said.splitlines()[-1])
    return seconds, size, ".".join(map(str, version))


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--capability", type=int, nargs="+", default=CAPABILITIES, metavar="N")
    parser.add_argument("--rounds", type=int, default=3, help="the median of so many (3)")
    options = parser.parse_args(arguments)
    rows = []
    for capability in options.capability:
        first, later, size, version = [], [], 0, ""
        for _ in range(options.rounds):
            with tempfile.TemporaryDirectory() as cache:
                seconds, size, version = measure(capability, Path(cache))
                first.append(seconds)
                later.append(measure(capability, Path(cache))[0])
        times = f"{median(first):.2f}", f"{median(later):.2f}"
        rows.append((f"{capability / 10:.1f}", *times, f"{size / 1e3:.0f}", version))
    print(f"{platform.machine()}, {usable_cores()} cores, median of {options.rounds}\n")
    head = ("capability", "first use, s", "later, s", "code, kB", "NVRTC")
    print("\n".join(table(head, rows)))


if __name__ == "__main__":
    main()
