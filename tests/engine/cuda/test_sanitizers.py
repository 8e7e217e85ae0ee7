"""The CUDA kernels under sanitizers; and these find what was put in on purpose.

Tensors of torch get red zones around them. The threads of a block are real ones.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.engine.cuda.shim import compiled

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[3]
ADDRESS = ("-O1", "-g", "-fsanitize=address", "-DSHIM_THREADS")
THREADS = ("-O1", "-g", "-fsanitize=thread", "-DSHIM_THREADS")
# A training step of few Gaussians: every kernel runs.
STEP = """
import sys
import torch
from roigs_engine.cuda import card
from roigs_engine.rasterize import rasterize
from roigs_engine.training import gpu_check
from tests.engine.cuda.shim import ShimProgram
torch.set_num_threads(1)
program = ShimProgram(sys.argv[1])
card.program = lambda device: program
gpu_check.COUNT, gpu_check.SIZE = int(sys.argv[2]), (int(sys.argv[3]), 17)
gpu_check.results(torch.device("cpu"), "cuda")
made = gpu_check.scene(torch.device("cpu"), gpu_check.COUNT, gpu_check.SIZE)
gpu_check.draw(made, "cuda", with_depth="median")
for tensor in made.model.values():
    tensor.requires_grad_()
gpu_check.draw(made, "cuda").image.sum().backward()
print("done", *sorted(set(program.launched)))
"""


def run(
    flags: tuple[str, ...], runtime: str, edits: dict[str, tuple[str, str]] | None = None
) -> str:
    """What a step prints with the kernels made with these flags."""
    library = compiled(flags, edits)
    compiler = shutil.which("g++")
    assert compiler is not None
    question = [compiler, f"-print-file-name={runtime}"]
    found = subprocess.run(question, capture_output=True, text=True, check=True).stdout.strip()
    if not Path(found).is_absolute():
        pytest.skip(f"{runtime} is not installed")
    environment = {
        **os.environ,
        "LD_PRELOAD": found,
        "ASAN_OPTIONS": "detect_leaks=0",
        "TSAN_OPTIONS": "report_signal_unsafe=0 ignore_noninstrumented_modules=1",
        "PYTHONPATH": str(ROOT),
    }
    process = subprocess.run(
        [sys.executable, "-c", STEP, str(library), "20", "18"],
        capture_output=True, text=True, check=False, env=environment, cwd=ROOT, timeout=600,
    )  # fmt: skip
    return process.stdout + process.stderr


def test_no_access_is_out_of_bounds() -> None:
    said = run(ADDRESS, "libasan.so")
    assert "AddressSanitizer" not in said and "done" in said, said[-3000:]


def test_an_access_out_of_bounds_is_found() -> None:
    edit = ("if (n >= f.gaussians.count) return;\n    int count", "int count")
    said = run(ADDRESS, "libasan.so", {"project.cu": edit})
    assert "AddressSanitizer: heap-buffer-overflow" in said, said[-3000:]


def test_no_two_threads_race() -> None:
    said = run(THREADS, "libtsan.so")
    assert "ThreadSanitizer" not in said and "done" in said, said[-3000:]


def test_a_missing_barrier_is_found() -> None:
    load = "count = load_batch(f, place, begin, end, batch);\n"
    barrier, loop = "        __syncthreads();\n", "        for (int i = 0; i < count; ++i) {"
    edit = (load + barrier + loop, load + loop)
    said = run(THREADS, "libtsan.so", {"blend.cu": edit})
    assert "ThreadSanitizer: data race" in said, said[-3000:]
