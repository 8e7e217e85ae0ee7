"""Other commands: levels of detail and clean-up of finished runs, and the check of a GPU."""

from __future__ import annotations

import platform
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..context import QUIET, Context
from ..errors import KernelError, RunFolderError
from ..formats import clean_up, run_files
from ..formats.files import refuse_linked_folders
from ..formats.lock import locked
from ..formats.text import in_gb
from ..requests.runs import CheckGpu, Clean, Levels
from .inputs import on_device, use_threads
from .outputs import Result
from .run_scene import cameras_of_run

if TYPE_CHECKING:
    import torch

    from ..formats.levels import Ladder

GPU_STEPS, CPU_STEPS = 50, 3


def make_levels(request: Levels, context: Context = QUIET) -> Result:
    """Train and measure levels of detail in the run folder, or resume.

    Raises:
        EngineError: the run folder or its scene cannot be used.
        Stopped: on request; the same request resumes.
    """
    from ..levels import make
    from ..model.local_frame import LocalFrame

    _check_run(request.run)
    use_threads(request.threads)
    said, context = context, on_device(context, request.device)
    with locked(request.run, context.warn, option=None):
        refuse_linked_folders(request.run)
        scene = cameras_of_run(request.run, request.scene, said)
        frame = LocalFrame.of_scene(scene)
        ladders = make.make_levels(
            request.run,
            frame.scene(scene).images,
            frame,
            levels=request.levels,
            steps=request.steps,
            context=context,
        )
    made = Result(files={"levels": request.run / run_files.LEVELS_FILE})
    return made.with_places(*_table_of(ladders))


def _table_of(ladders: Sequence[Ladder]) -> list[str]:
    rows = [
        "| part | Gaussians | from | PSNR | PSNR of the whole part |",
        "|---|---:|---:|---:|---:|",
    ]
    for ladder in ladders:
        for level in ladder.levels:
            row = f"| {ladder.box or 'surroundings'} | {level.gaussians:,} |"
            if level.farther:
                psnr, whole = (level.measured[key] for key in ("psnr", "psnr_whole"))
                row += f" {level.farther:.1f} x the distance | {psnr:.1f} | {whole:.1f} |"
            else:
                row += " | | |"
            rows.append(row)
    return rows


@dataclass(frozen=True, kw_only=True)
class Cleaned(Result):
    """Removable files and folders of a run, with bytes, and the freed space."""

    removable: tuple[tuple[str, int], ...]
    freed: int = 0


def clean(request: Clean, context: Context = QUIET) -> Cleaned:
    """Remove files from a run folder that can be made again; RunFolderError if it is not one."""
    _check_run(request.run)
    with locked(request.run, context.warn, option=None):
        sizes: Counter[str] = Counter()
        for path in clean_up.removable(request.run):
            place = path if path.parent == request.run else path.parent
            sizes[str(place.relative_to(request.run))] += clean_up.disk_size([path])
        found = tuple(sizes.items())
        text = "\n".join(f"{in_gb(size):>8}  {place}" for place, size in found)
        if request.dry_run:
            return Cleaned(removable=found, text=text)
        freed = clean_up.remove(request.run)
    context.info(f"Removed {in_gb(freed)}." if freed else "There is nothing to remove.")
    return Cleaned(removable=found, freed=freed, text=text)


def _check_run(folder: Path) -> None:
    if not clean_up.is_run_folder(folder):
        raise RunFolderError(
            f"{folder} is not a run folder.", "Give the folder that --run-dir named."
        )


def check_gpu(
    request: CheckGpu, context: Context = QUIET, say: Callable[[str], None] | None = None
) -> Result:
    """Check a GPU against the CPU, and time training steps on both.

    Args:
        request: extent of the check, and the GPU.
        context: receives messages, with `brief` about the device that training would use.
        say: gets each line at once: versions, the card, errors of each result, milliseconds per
            step. None for the context.

    Raises:
        KernelError: the GPU cannot be used.
    """
    import torch

    from ..cuda import driver
    from ..cuda.device import CPU, choose_device
    from ..training import gpu_check

    if request.brief:
        choose_device(request.device, context, gpu_check.check_once)
        return Result()
    say = say or context.info
    version = ".".join(map(str, sys.version_info[:3]))
    say(f"System   {platform.platform()}, Python {version}")
    say(f"torch    {torch.__version__}, CUDA {torch.version.cuda or '(none)'}")
    say(f"Driver   {driver.build() or '(not found)'}")
    device = _opened_gpu(request.device, context, say)
    for result, error in gpu_check.compare(device).items():
        verdict = "ok   " if error <= gpu_check.LIMIT else "WRONG"
        say(f"  {error:.1e}  {verdict}  {result}")
    gpu_check.check_again(device)
    width, height = gpu_check.SIZE_TIMED
    say(f"Step     {gpu_check.COUNT_TIMED:,} Gaussians, {width}x{height}:")
    gpu = gpu_check.step_milliseconds(device, gpu_check.backend_of(device), steps=GPU_STEPS)
    say(f"  GPU {gpu:8.2f} ms")
    cpu = gpu_check.step_milliseconds(CPU, "cpu", steps=CPU_STEPS)
    say(f"  CPU {cpu:8.2f} ms")
    context.info("The GPU computes what the CPU does.")
    return Result()


def _opened_gpu(name: str, context: Context, say: Callable[[str], None]) -> torch.device:
    """Open a GPU, NVIDIA's or another one; return its tensors' device; KernelError without one."""
    import torch

    from ..cuda import compiler
    from ..cuda.device import CPU, GPU, check_cuda
    from ..gpu.adapters import is_any
    from ..gpu.program import open_gpu

    started, device = time.perf_counter(), CPU
    kind, _, wanted = name.partition(":")
    if kind != GPU:
        try:
            device = check_cuda(context)
        except KernelError:
            if kind == "cuda" or not is_any():
                raise
            kind = GPU
    if kind == GPU:
        adapter = open_gpu(wanted).adapter
        say(f"GPU      {adapter.title}; {adapter.driver}")
        say(f"Kernels  ready in {time.perf_counter() - started:.1f} s")
        return CPU
    seconds = time.perf_counter() - started
    capability = ".".join(map(str, torch.cuda.get_device_capability(device)))
    memory = torch.cuda.get_device_properties(device).total_memory / 2**30
    title = torch.cuda.get_device_name(device)
    say(f"Card     {title}, compute capability {capability}, {memory:.1f} GiB")
    nvrtc = ".".join(map(str, compiler.load().version))
    say(f"Kernels  ready in {seconds:.1f} s, NVRTC {nvrtc}")
    return device
