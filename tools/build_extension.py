"""Builds the Blender extension and a static repository that offers it, into dist/.

    python tools/build_extension.py [BLENDER]

The repository is the whole folder: the zip, `index.json`, which Blender reads, and `index.html`, a
page with a link to drag into Blender. Zips of earlier versions are removed, because a repository
offers one. All this is done by the program that is named, or else by Blender's own builder from the
bpy module, which needs no Blender to run.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import blender_module

BUILDER = "bpy/*/scripts/addons_core/bl_pkg/cli/blender_ext.py"


def builder(blender: str | None) -> list[str]:
    """The command line to which `validate`, `build` and `server-generate` are added."""
    if blender:
        return [blender, "--command", "extension"]
    python = blender_module.python()
    packages = subprocess.check_output(
        [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], text=True
    )
    (script,) = Path(packages.strip()).glob(BUILDER)
    return [str(python), str(script)]


def build(command: list[str], out: Path) -> int:
    """Validate, build, and list the result; returns the first exit status that is not 0."""
    root = blender_module.ROOT
    out.mkdir(exist_ok=True)
    for earlier in out.glob("roigs-*.zip"):
        earlier.unlink()
    for step in (
        ["validate", str(root)],
        ["build", "--source-dir", str(root), "--output-dir", str(out)],
        ["server-generate", "--repo-dir", str(out), "--html"],
    ):
        status = subprocess.run([*command, *step], check=False).returncode
        if status:
            return status
    return 0


def main() -> int:
    """Run the command; returns the exit status."""
    try:
        command = builder(sys.argv[1] if len(sys.argv) > 1 else None)
    except blender_module.NoBlenderError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return build(command, blender_module.ROOT / "dist")


if __name__ == "__main__":
    sys.exit(main())
