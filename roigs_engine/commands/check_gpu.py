"""`check-gpu`: all that decides whether an NVIDIA GPU can train, for bug reports."""

from __future__ import annotations

import argparse
import platform
import sys
import time

from .console import Console

HELP = "check an NVIDIA GPU against the CPU, and time training steps on both"
EXAMPLES = """\
  python -m roigs_engine check-gpu
  python -m roigs_engine check-gpu --brief"""

GPU_STEPS, CPU_STEPS = 50, 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's option."""
    parser.add_argument(
        "--brief", action="store_true", help="only say which device training would use, and why"
    )


def run(args: argparse.Namespace, console: Console) -> dict[str, str]:
    """Print versions, the card, the errors of each result, and milliseconds a step.

    Raises:
        KernelError: the GPU cannot be used.
    """
    import torch

    from ..cuda import compiler, driver
    from ..cuda.device import CPU, check_cuda, choose_device
    from ..training import gpu_check, gpu_times

    if args.brief:
        choose_device("auto", console.context, gpu_check.check_once)
        return {}
    version = ".".join(map(str, sys.version_info[:3]))
    console.print(f"System   {platform.platform()}, Python {version}")
    console.print(f"torch    {torch.__version__}, CUDA {torch.version.cuda or '(none)'}")
    console.print(f"Driver   {driver.build() or '(not found)'}")
    started = time.perf_counter()
    device = check_cuda(console.context)
    seconds = time.perf_counter() - started
    capability = ".".join(map(str, torch.cuda.get_device_capability(device)))
    memory = torch.cuda.get_device_properties(device).total_memory / 2**30
    name = torch.cuda.get_device_name(device)
    console.print(f"Card     {name}, compute capability {capability}, {memory:.1f} GiB")
    nvrtc = ".".join(map(str, compiler.nvrtc_of_torch().version))
    console.print(f"Kernels  ready in {seconds:.1f} s, NVRTC {nvrtc}")
    errors = gpu_check.compare(device)
    for result, error in errors.items():
        console.print(
            f"  {error:.1e}  {'ok   ' if error <= gpu_check.LIMIT else 'WRONG'}  {result}"
        )
    gpu_check.check_again(device)
    width, height = gpu_times.SIZE
    console.print(f"Step     {gpu_times.COUNT:,} Gaussians, {width}x{height}:")
    gpu = gpu_times.step_milliseconds(device, "cuda", steps=GPU_STEPS)
    console.print(f"  GPU {gpu:8.2f} ms")
    cpu = gpu_times.step_milliseconds(CPU, "cpu", steps=CPU_STEPS)
    console.print(f"  CPU {cpu:8.2f} ms")
    console.context.info("The GPU computes what the CPU does. Training uses it.")
    return {}
