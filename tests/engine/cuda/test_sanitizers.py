"""The CUDA kernels under sanitizers; and these find what was put in on purpose.

Tensors of torch get red zones around them. The threads of a block are real ones.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from roigs_engine.cuda.compiler import KERNELS
from tests.engine.cuda.shim import Edit, compiled

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


def run(flags: tuple[str, ...], runtime: str, edits: Sequence[Edit] = ()) -> str:
    """The output of a step with kernels compiled with these flags."""
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
        "ASAN_OPTIONS": "detect_leaks=0 halt_on_error=0",
        "TSAN_OPTIONS": "report_signal_unsafe=0 ignore_noninstrumented_modules=1"
        " suppress_equal_addresses=0 history_size=7",
        "PYTHONPATH": str(ROOT),
    }
    process = subprocess.run(
        [sys.executable, "-c", STEP, str(library), "20", "18"],
        capture_output=True, text=True, check=False, env=environment, cwd=ROOT, timeout=600,
    )  # fmt: skip
    return process.stdout + process.stderr


def of_kernels(said: str, error: str) -> set[str]:
    """The kernels in whose calls a sanitizer has found such errors."""
    frames = "|".join(KERNELS)
    found = re.compile(rf"#\d+ (?:0x[0-9a-f]+ in )?({frames}) /")
    firsts = (found.search(report) for report in said.split(error)[1:])
    return {match[1] for match in firsts if match}


def test_no_access_is_out_of_bounds() -> None:
    said = run(ADDRESS, "libasan.so")
    assert "AddressSanitizer" not in said and "done" in said, said[-3000:]
    assert set(said.split("done ")[1].split()) == set(KERNELS)  # all of them ran


OUT_OF_BOUNDS = {
    "place_camera": (
        "project.cu",
        "f.camera_values[19 + row] =",
        "f.camera_values[19 + row] = f.camera_values[20 + row] =",
    ),
    "project": ("project.cu", "f.visible[n] = count > 0", "f.visible[n + 1] = count > 0"),
    "list_tiles": (
        "project.cu",
        "f.visible[n] = 0;\n        return;\n    }",
        "return; }\n    f.visible[n + 20] = 1;",
    ),
    "begin_tiles": (  # others rely on what they write: that stays right
        "project.cu",
        "f.tile_begin[tile] =",
        "f.tile_begin[tile] = f.tile_begin[tile + (tile == f.tile_count)] =",
    ),
    "begin_groups": (
        "project.cu",
        "f.group_begin[tile + 1] =",
        "f.group_begin[tile + 1] = f.group_begin[tile + 1 + (tile + 1 == f.tile_count)] =",
    ),
    "blend": ("blend.cu", "f.out.alpha[at] = 1", "f.out.alpha[at + 1] = 1"),
    "median_depth": ("blend.cu", "(pixel)] = depth", "(pixel) + 1] = depth"),
    "weigh": ("weigh.cu", "f.slot_sums[slot] = sum", "f.slot_sums[slot + 1] = sum"),
    "fold_weights": ("weigh.cu", "f.out.weight_sum[n] += sum", "f.out.weight_sum[n + 1] += sum"),
    "gradient": ("gradient.cu", "kMoments + k] = sum[k]", "kMoments + k + 1] = sum[k]"),
    "project_backward": ("backward.cu", "kWidth + k] += row[k]", "kWidth + k + 1] += row[k]"),
    "project_backward_adam": ("backward.cu", "p.values[at] = value", "p.values[at + 1] = value"),
    "loss": ("loss.cu", "at < 0 ? 0.0f : l.image[", "l.image["),
    "loss_gradient": (
        "loss.cu",
        "plane + at] =\n        l.scale",
        "plane + at + 1] =\n        l.scale",
    ),
    "loss_terms": ("loss.cu", "l.terms[2] = ", "l.terms[3] = "),
}
"""For each kernel, what makes it leave its arrays."""


def test_accesses_out_of_bounds_are_found() -> None:
    """All in one build, which goes on after an error."""
    said = run((*ADDRESS, "-fsanitize-recover=address"), "libasan.so", list(OUT_OF_BOUNDS.values()))
    assert of_kernels(said, "AddressSanitizer: heap-buffer-overflow") == set(OUT_OF_BOUNDS)


def test_no_two_threads_race() -> None:
    said = run(THREADS, "libtsan.so")
    assert "ThreadSanitizer" not in said and "done" in said, said[-3000:]


BATCH = "load_batch(f, place, begin, end, batch);\n"
BARRIER = "        __syncthreads();\n"
RACES = {
    "place_camera": ("project.cu", "f.camera_values[12 + row]", "f.camera_values[12]"),
    "project": ("project.cu", "f.visible[n] = count > 0;", "f.visible[0] = count > 0;"),
    "list_tiles": (
        "project.cu",
        "f.first_slot[n] = int32_t(slot);",
        "f.first_slot[n] = int32_t(slot); f.depths[0] = 1.0f;",
    ),
    "begin_tiles": ("project.cu", "f.tile_begin[tile] = int32_t(i);", "f.tile_begin[0] = 0;"),
    "begin_groups": ("project.cu", "sums[mine] += earlier;\n        }\n        __syncthreads();",
                     "sums[mine] += earlier;\n        }"),
    "blend": ("blend.cu", f"{BATCH}{BARRIER}        for (int i = 0; i < count; ++i) {{",
              f"{BATCH}        for (int i = 0; i < count; ++i) {{"),
    "median_depth": ("blend.cu", f"{BATCH}{BARRIER}        for (int i = 0; i < count && left",
                     f"{BATCH}        for (int i = 0; i < count && left"),
    "weigh": ("weigh.cu", "1.0f, 0, 0, 0);\n    }\n    __syncthreads();",
              "1.0f, 0, 0, 0);\n    }"),
    "fold_weights": ("weigh.cu", "f.out.max_weight[n] = ", "f.out.max_weight[0] = "),
    "gradient": ("gradient.cu", "pixels[p] = pixel;\n    }\n    __syncthreads();",
                 "pixels[p] = pixel;\n    }"),
    "project_backward": ("backward.cu", "add_row(f.gradients.means, n, row.mean);",
                         "add_row(f.gradients.means, n, row.mean); f.grad2d[0] = 0;"),
    "project_backward_adam": ("backward.cu", "basis[lane][k] = row.basis[k];",
                              "basis[0][k] = row.basis[k];"),
    "loss": ("loss.cu", "photo(l, tile.channel, at);\n    }\n    __syncthreads();",
             "photo(l, tile.channel, at);\n    }"),
    "loss_gradient": ("loss.cu", "tile.channel) * plane + at];\n    }\n    __syncthreads();",
                      "tile.channel) * plane + at];\n    }"),
    "loss_terms": ("loss.cu", "half /= 2) {\n        __syncthreads();", "half /= 2) {"),
}  # fmt: skip
"""For each kernel, a barrier that is missing or a place that two threads write to."""


def test_races_are_found() -> None:
    """Of many races in one build a run shows some: which, depends on how the threads take turns."""
    missing = set(RACES)
    for _ in range(4):
        said = run(THREADS, "libtsan.so", [RACES[name] for name in sorted(missing)])
        missing -= of_kernels(said, "ThreadSanitizer: data race")
        if not missing:
            return
    pytest.fail(f"no race was found in {missing}")
