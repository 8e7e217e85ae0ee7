"""Makes a .blend, a PLY and a picture from photos or a COLMAP folder, without a window.

    blender -b --python headless.py -- --photos photos --out out
    blender -b --python headless.py -- --colmap garden --roi vase=-0.4,0,-0.4,0.4,1.3,0.4 --out out

Also with the `bpy` module: `python headless.py --colmap …`. Exit status: 0 done, 2 an error (one
line on standard error), 3 stopped by Ctrl-C or SIGTERM; the same command then resumes.
docs/scripting.md explains the steps.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy

STOPPED = 3
ops: Any = bpy.ops
"""Operators, those of add-ons among them."""


def parse(argv: list[str]) -> argparse.Namespace:
    """The options; those of Blender itself come before `--`."""
    own = argv[argv.index("--") + 1 :] if "--" in argv else argv[1:]
    parser = argparse.ArgumentParser(prog="headless.py", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--photos", type=Path, help="folder of photos to reconstruct first")
    parser.add_argument(
        "--colmap",
        type=Path,
        help="folder of the COLMAP project; with --photos, where it goes (default: OUT/colmap)",
    )
    parser.add_argument("--images", type=Path, help="folder of the photos (default: found)")
    parser.add_argument(
        "--roi",
        action="append",
        default=[],
        metavar="NAME=x0,y0,z0,x1,y1,z1",
        help="a box by two corners in the COLMAP frame; repeatable",
    )
    parser.add_argument("--rois", type=Path, help="rois.json with boxes")
    parser.add_argument(
        "--out", type=Path, required=True, help="folder for everything that is made"
    )
    parser.add_argument("--preset", choices=("draft", "standard", "paper"), default="draft")
    parser.add_argument(
        "--strategy", choices=("joint", "independent"), help="default: the preset's own"
    )
    parser.add_argument("--max-side", type=int, default=640, help="longest side of photos (640)")
    parser.add_argument(
        "--steps-factor", type=float, default=1.0, help="multiplies the preset's steps"
    )
    parser.add_argument(
        "--test-every", type=int, default=0, help="use every n-th photo as a test photo (0: none)"
    )
    parser.add_argument(
        "--photo", help="the photo to render (default: the best one of the first box)"
    )
    options = parser.parse_args(own)
    if not options.photos and not options.colmap:
        parser.error("give --photos or --colmap")
    if not options.photos and not options.roi and not options.rois:
        parser.error("give at least one box, with --roi or --rois")
    options.colmap = options.colmap or options.out / "colmap"
    options.roi = [_corners(parser, text) for text in options.roi]
    return options


def _corners(parser: argparse.ArgumentParser, text: str) -> tuple[str, list[float]]:
    name, _, numbers = text.partition("=")
    try:
        values = [float(number) for number in numbers.split(",")]
    except ValueError:
        values = []
    if not name or len(values) != 6:
        parser.error(f"cannot read the box '{text}': write NAME=x0,y0,z0,x1,y1,z1")
    return name, values


class Stopped(Exception):  # noqa: N818 - not an error
    """An operator was stopped on request."""


def do(operator: Callable[..., set[str]], **properties: Any) -> None:
    """Call an operator; RuntimeError when it fails, Stopped when it was stopped."""
    if operator(**properties) != {"FINISHED"}:
        raise Stopped


def make(options: argparse.Namespace) -> None:
    """Do every step of the panel, in order."""
    out = options.out.resolve()
    ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene: Any = bpy.context.scene
    settings = scene.roigs
    settings.run_dir = str(out)
    settings.preset = options.preset  # sets strategy and selection, too
    if options.strategy:
        settings.strategy = options.strategy
    settings.max_side, settings.steps_factor = options.max_side, options.steps_factor
    settings.test_every = options.test_every

    import_scene(options)
    if options.rois:
        do(ops.roigs.load_rois, filepath=str(options.rois.resolve()))
    for name, numbers in options.roi:
        do(ops.roigs.add_box, name=name, low=numbers[:3], high=numbers[3:])
    if not options.rois and not options.roi:
        do(ops.roigs.add_roi)  # where most photos look
    do(ops.roigs.select_cameras)
    do(ops.roigs.train_roi)

    boxes = sorted((o for o in scene.objects if o.roigs.kind == "ROI"), key=lambda o: o.name)
    do(ops.roigs.look_through, photo=options.photo or boxes[0].roigs.selection[0].name)
    render(scene, out / "picture.png")
    do(ops.wm.save_as_mainfile, filepath=str(out / "scene.blend"))
    for what, where in (
        ("file", "scene.blend"),
        ("result", "result.ply"),
        ("picture", "picture.png"),
    ):
        print(f"{what + ':':10}{options.out / where}")


def import_scene(options: argparse.Namespace) -> None:
    """The COLMAP project; made from photos first, if there are some."""
    colmap = str(options.colmap.resolve())
    if options.photos:
        do(ops.roigs.reconstruct, photos=str(options.photos.resolve()), project=colmap)
        return
    images = str(options.images.resolve()) if options.images else ""
    do(ops.roigs.import_colmap, directory=colmap, images=images)


def render(scene: Any, path: Path) -> None:
    """Render as F12 does. Without meshes and lights, one sample is enough."""
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    scene.cycles.use_denoising = False
    scene.view_settings.view_transform = "Standard"  # the photos' colours
    scene.render.filepath = str(path)
    do(ops.render.render, write_still=True)


@contextmanager
def add_on() -> Iterator[None]:
    """The installed add-on, or else the one that this script is part of."""
    if hasattr(bpy.types.Scene, "roigs"):
        yield
        return
    import addon_utils  # available once bpy is imported

    installed: Any = addon_utils
    for module in installed.modules():
        if module.__name__.rpartition(".")[2] == "roigs":
            addon_utils.enable(module.__name__)
            yield
            return
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
    import roigs_addon

    roigs_addon.register()
    try:
        yield
    finally:  # the bpy module does not exit while classes are registered
        roigs_addon.unregister()


def main() -> int:
    """Do everything; returns the exit status."""
    options = parse(sys.argv)
    try:
        with add_on():
            make(options)
    except RuntimeError as error:  # a failed operator raises this, with the text 'Error: …'
        lines = [line.removeprefix("Error: ") for line in str(error).splitlines() if line.strip()]
        print(f"error: {lines[-1] if lines else 'no reason was given'}", file=sys.stderr)
        return 2
    except Stopped:
        print("Stopped. Run the same command again to resume.", file=sys.stderr)
        return STOPPED
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
