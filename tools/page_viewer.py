"""Builds the viewer of web pages (`convert OUT.html`) with npm, into the package.

    python tools/page_viewer.py

Needs npm and network. Bundles what the page uses of GaussianSplats3D and three.js (both MIT) into
one minified script, and puts their licences beside it. Versions are fixed, so the same ones give
the same file; both files are in the repository, and pages need neither npm nor network.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

OUT = Path(__file__).resolve().parent.parent / "roigs_engine" / "exchange" / "page_parts"
LIBRARIES = {"@mkkellogg/gaussian-splats-3d": "0.4.7", "three": "0.187.0"}
BUNDLER = "esbuild@0.28.2"
ENTRY = """\
import { SplatBufferGenerator, Viewer } from '@mkkellogg/gaussian-splats-3d';
window.Splats = { SplatBufferGenerator, Viewer };
"""


def build(folder: Path) -> None:
    """Fetch and bundle in `folder`; write into the package.

    Raises:
        CalledProcessError: npm or the bundler failed.
        OSError: npm is missing, or a file cannot be written.
    """
    packages = [f"{name}@{version}" for name, version in LIBRARIES.items()]
    npm = shutil.which("npm") or "npm"
    (folder / "package.json").write_text("{}")
    options = ["--no-audit", "--no-fund", "--ignore-scripts"]
    subprocess.run([npm, "install", *options, *packages, BUNDLER], cwd=folder, check=True)
    (folder / "entry.js").write_text(ENTRY)
    bundle = ["esbuild", "entry.js", "--bundle", "--minify", "--format=iife", "--charset=ascii"]
    made = ["--legal-comments=none", "--target=es2020", "--outfile=viewer.min.js"]
    subprocess.run([npm, "exec", "--no", "--", *bundle, *made], cwd=folder, check=True)
    licences = [
        f"{name} {version}\n\n{(folder / 'node_modules' / name / 'LICENSE').read_text()}"
        for name, version in LIBRARIES.items()
    ]
    OUT.mkdir(exist_ok=True)
    (OUT / "viewer.LICENSE.txt").write_text("\n\n".join(licences))
    shutil.copyfile(folder / "viewer.min.js", OUT / "viewer.min.js")


def main() -> int:
    """The exit status."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            build(Path(folder))
        except (OSError, subprocess.CalledProcessError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
    print(f"{(OUT / 'viewer.min.js').stat().st_size:,} bytes in {OUT / 'viewer.min.js'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
