"""Builds the Blender extension, a zip, into dist/.

    python tools/build_extension.py [BLENDER]

With the program that is named, or else with Blender's own builder from the bpy module, which needs
no Blender to run.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import blender_module

BUILDER = "bpy/*/scripts/addons_core/bl_pkg/cli/blender_ext.py"


def builder(blender: str | None) -> list[str]:
    """The command line that takes `validate` and `build`."""
    if blender:
        return [blender, "--command", "extension"]
    python = blender_module.python()
    packages = subprocess.check_output(
        [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], text=True
    )
    (script,) = Path(packages.strip()).glob(BUILDER)
    return [str(python), str(script)]


def main() -> int:
    """Validate and build; the exit status."""
    root = blender_module.ROOT
    try:
        command = builder(sys.argv[1] if len(sys.argv) > 1 else None)
    except blender_module.NoBlenderError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    out = root / "dist"
    out.mkdir(exist_ok=True)
    for step in (
        ["validate", str(root)],
        ["build", "--source-dir", str(root), "--output-dir", str(out)],
    ):
        status = subprocess.run([*command, *step], check=False).returncode
        if status:
            return status
    return 0


if __name__ == "__main__":
    sys.exit(main())
