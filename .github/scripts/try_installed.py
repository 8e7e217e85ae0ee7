"""Uses an installed roigs: its version, the compiled kernels in its package, the demo scene.

    python .github/scripts/try_installed.py

Run it from a folder outside the project, so that the installed package is what Python finds.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCENE = ROOT / "demo" / "scene"
KERNELS = """
from roigs_engine.kernels import build, library
folder = library.PACKAGE_FOLDER
assert build.is_current(folder, build.native_platform()), f"no kernels in {folder}"
print("kernels:", library.isa(), "in", folder)
"""


def main() -> int:
    """Run the commands one after the other; the status of the first that fails, or 0."""
    engine = [sys.executable, "-m", "roigs_engine"]
    for command in (
        [*engine, "--version"],
        [sys.executable, "-c", KERNELS],
        [*engine, "inspect", str(SCENE), "--rois", str(SCENE / "rois.json")],
    ):
        status = subprocess.run(command, check=False).returncode
        if status:
            return status
    return 0


if __name__ == "__main__":
    sys.exit(main())
