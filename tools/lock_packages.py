"""Writes tools/locked/: versions and hashes of what **Set Up the Engine** installs.

    python tools/lock_packages.py

One file for each step of the set-up, for every platform and Python from 3.11 on, made by uv from
the requirements of pyproject.toml. Run it when these change, or to take newer versions. Torch, and
what torch needs for a graphics card, are not among them: each of PyTorch's indexes has builds of
its own.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LOCKED = ROOT / "tools" / "locked"
OF_TORCH = re.compile(r"(torch|triton|nvidia-[a-z0-9-]+|cuda-[a-z0-9-]+)==")


def entries(text: str) -> list[str]:
    """Split a requirements file into packages: a line with the version, and lines of hashes."""
    return re.findall(r"^\S.*\n(?:[ \t]+.*\n)*", text, flags=re.MULTILINE)


def compiled(requirements: Sequence[str], constraints: Path | None = None) -> str:
    """Packages that pip would install for the requirements, with hashes; without torch and CUDA."""
    uv = shutil.which("uv", path=str(Path(sys.executable).parent)) or shutil.which("uv")
    if uv is None:
        raise SystemExit("error: uv is not installed; run python -m pip install uv")
    command = [uv, "pip", "compile", "-", "--quiet", "--universal", "--python-version", "3.11"]
    command += ["--generate-hashes", "--no-header", "--no-annotate", "--no-emit-index-url"]
    if constraints is not None:
        command += ["--constraints", str(constraints)]
    done = subprocess.run(
        command, input="\n".join(requirements), capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"error: uv found no versions\n{done.stderr}")
    return "".join(entry for entry in entries(done.stdout) if not OF_TORCH.match(entry))


def main() -> None:
    """Rewrite all files."""
    sys.path.insert(0, str(ROOT))
    from roigs_addon.engine import install_steps

    shutil.rmtree(LOCKED, ignore_errors=True)
    LOCKED.mkdir()
    engine = LOCKED / f"{install_steps.ENGINE}.txt"
    (LOCKED / f"{install_steps.PIP}.txt").write_text(compiled(["pip>=24.1"]), encoding="utf-8")
    engine.write_text(compiled(install_steps.requirements()), encoding="utf-8")
    for package in install_steps.optional_packages(formats=True):
        path = LOCKED / f"{install_steps.name_of(package)}.txt"
        path.write_text(compiled([package], engine), encoding="utf-8")


if __name__ == "__main__":
    main()
