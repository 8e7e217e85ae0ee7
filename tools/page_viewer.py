"""Builds the viewer of web pages (`convert OUT.html`) with npm, into the package.

    python tools/page_viewer.py

Needs npm and network. Bundles what the page uses of GaussianSplats3D and three.js (both MIT) into
one minified script, and puts their licences beside it. `CHANGES` to the former draw what our
renderer draws: it left out large Gaussians whose centre is beside the picture. Versions are fixed,
so the same ones give the same file; both files are in the repository, and pages need neither npm
nor network.
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
SOURCE = "node_modules/@mkkellogg/gaussian-splats-3d/build/gaussian-splats-3d.module.js"
CULLED = """\
            if (clipCenter.z < -clip || clipCenter.x < -clip || clipCenter.x > clip || \
clipCenter.y < -clip || clipCenter.y > clip) {"""
LIMIT = "-3.0 * viewCenter.z"  # MAX_SLOPE of roigs_engine.rasterize.inputs; z points backwards
CHANGES = {
    CULLED: f"""\
            if (clipCenter.z < -clip || viewCenter.z >= 0.0 || abs(viewCenter.x) > {LIMIT} ||
                abs(viewCenter.y) > {LIMIT}) {{""",
    # The Jacobian at a centre far beside the picture would make huge Gaussians; as 3DGS has it.
    "float s = 1.0 / (viewCenter.z * viewCenter.z);": """\
vec2 most = 1.3 * abs(viewCenter.z) / vec2(projectionMatrix[0][0], projectionMatrix[1][1]);
                vec2 near = clamp(viewCenter.xy, -most, most);
                float s = 1.0 / (viewCenter.z * viewCenter.z);""",
    "-(focal.x * viewCenter.x) * s,": "-(focal.x * near.x) * s,",
    "-(focal.y * viewCenter.y) * s,": "-(focal.y * near.y) * s,",
}
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
    source = folder / SOURCE
    text = source.read_text(encoding="utf-8")
    for before, after in CHANGES.items():
        if text.count(before) != 1:
            raise OSError(f"{SOURCE} is not the version that the changes are for")
        text = text.replace(before, after)
    source.write_text(text, encoding="utf-8")
    bundle = ["esbuild", "entry.js", "--bundle", "--minify", "--format=iife", "--charset=ascii"]
    made = ["--legal-comments=none", "--target=es2020", "--outfile=viewer.min.js"]
    subprocess.run([npm, "exec", "--no", "--", *bundle, *made], cwd=folder, check=True)
    licences = []
    for name, version in LIBRARIES.items():
        licence = (folder / "node_modules" / name / "LICENSE").read_text(encoding="utf-8")
        changed = " (changed: tools/page_viewer.py)" if name in SOURCE else ""
        licences.append(f"{name} {version}{changed}\n\n{licence}")
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
