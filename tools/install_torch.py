"""Installs the torch that pyproject.toml asks for, as a build for the CPU.

    python tools/install_torch.py [--index URL]

On Linux, PyPI's torch is a CUDA build of several gigabytes. This script asks pip first what it
would install, without downloading it; when that holds CUDA packages, torch comes from PyTorch's own
index of CPU builds instead. `--index` (or the variable TORCH_INDEX) names another index and skips
the question, for example https://download.pytorch.org/whl/cu130 for a graphics card.

Run it with the Python of the environment to install into. It needs nothing but pip.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from typing import Any

CPU_INDEX = "https://download.pytorch.org/whl/cpu"
PYPROJECT = Path(__file__).resolve().parent.parent / "pyproject.toml"
# From this version on, `pip install --dry-run` reads a wheel's metadata without the wheel.
PIP_WITHOUT_DOWNLOAD = (23, 3)


def wanted_torch(pyproject: Path = PYPROJECT) -> str:
    """The requirement on torch in pyproject.toml, in pip's form."""
    project = tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]
    extras = project.get("optional-dependencies", {}).values()
    for requirement in [*project.get("dependencies", []), *(r for extra in extras for r in extra)]:
        if re.match(r"torch\b(?![-.])", requirement):
            return str(requirement)
    raise SystemExit(f"error: {pyproject} does not ask for torch.")


def pulls_cuda(report: dict[str, Any]) -> bool:
    """Whether pip's installation report lists packages for GPUs."""
    for item in report.get("install", []):
        name = re.sub(r"[-_.]+", "-", item["metadata"]["name"]).lower()
        local = item["metadata"]["version"].partition("+")[2]
        if name.startswith(("nvidia-", "cuda-")) or name in ("triton", "pytorch-triton-rocm"):
            return True
        if name == "torch" and local.startswith(("cu", "rocm", "xpu")):
            return True
    return False


def choose_index(report: dict[str, Any] | None, platform: str = sys.platform) -> str | None:
    """The index to install torch from; None: the one in pip's configuration.

    Args:
        report: pip's installation report; None if pip could not write one.
        platform: as `sys.platform`.
    """
    if report is None:
        return CPU_INDEX if platform.startswith("linux") else None
    return CPU_INDEX if pulls_cuda(report) else None


def installed(requirement: str) -> bool:
    """Whether any build of the required version is in this environment."""
    try:
        version = metadata.version("torch")
    except metadata.PackageNotFoundError:
        return False
    return requirement.replace(" ", "") == f"torch=={version.partition('+')[0]}"


def pip(*arguments: str, capture: bool = False) -> subprocess.CompletedProcess[str]:
    """Run this environment's pip."""
    command = [sys.executable, "-I", "-m", "pip", "--disable-pip-version-check", *arguments]
    output = subprocess.PIPE if capture else None
    return subprocess.run(command, check=False, text=True, stdout=output, stderr=output)


def ask_pip(requirement: str) -> dict[str, Any] | None:
    """pip's report on what it would install for the requirement; None if pip cannot tell."""
    version = tuple(int(part) for part in re.findall(r"\d+", metadata.version("pip"))[:2])
    if version < PIP_WITHOUT_DOWNLOAD:
        least = ".".join(map(str, PIP_WITHOUT_DOWNLOAD))
        if pip("install", "--quiet", f"pip>={least}", capture=True).returncode:
            return None
    result = pip("install", "--dry-run", "--quiet", "--report", "-", requirement, capture=True)
    try:
        report = json.loads(result.stdout) if result.returncode == 0 else None
    except ValueError:
        return None
    return report if isinstance(report, dict) else None


def main() -> int:
    """Install torch unless it is installed; returns pip's exit status."""
    parser = argparse.ArgumentParser(description="Install torch as a build for the CPU.")
    parser.add_argument(
        "--index",
        default=os.environ.get("TORCH_INDEX", ""),
        metavar="URL",
        help="index to install from (default: $TORCH_INDEX, else found out)",
    )
    index = parser.parse_args().index or None
    requirement = wanted_torch()
    if installed(requirement):
        return 0
    if index is None:
        index = choose_index(ask_pip(requirement))
    print(f"Installing {requirement} from {index or 'the default index'}.", flush=True)
    where = ["--index-url", index] if index else []
    # Its thousands of modules are compiled when they are imported. Most never are.
    return pip("install", "--quiet", "--no-compile", *where, requirement).returncode


if __name__ == "__main__":
    sys.exit(main())
