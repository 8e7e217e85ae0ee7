"""Makes the pictures of docs/user_guide.md, in a real Blender window.

    python -m tools.window.pictures BLENDER --engine-python PYTHON [--out docs/pictures]

Needs what `driver` needs, and some minutes: the demo scene is trained.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

from .driver import REPOSITORY, Blender, Screen, with_extension
from .scenario import (
    BUSY,
    STATE,
    addon,
    import_demo,
    load_boxes,
    parser,
    prepare,
)

SIZE = (1040, 980)
DRAWING = addon("viewport.draw")
SURFACE_BELOW = 28
"""Pixels from the button Export to the header of the panel Surface."""
COLOURS = ("+dither", "-colors", "128")
"""Options for small files; the loss is invisible."""

LOOK = """
bpy.context.preferences.view.ui_scale = 0.85
call("screen.screen_full_area", use_hide_panels=False)
view()["area"].spaces.active.overlay.show_floor = False
"""
PREFERENCES = """
call("preferences.addon_show", module="bl_ext.user_default.roigs")
"""


def select(blender: Blender, kind: str) -> None:
    """Select the objects of a kind, and make them fill the view."""
    blender.ask(
        f"[o.select_set(o.roigs.kind == {kind!r}) for o in bpy.context.scene.objects] and None"
    )
    blender.ask("call('view3d.view_selected')")


def look_at_boxes(blender: Blender) -> None:
    """Make the boxes fill the view beside the sidebar."""
    select(blender, "ROI")
    for _ in range(2):  # the sidebar lies over the view's right side
        blender.ask("call('view3d.zoom', delta=-1)")
    blender.ask("call('roigs.select_roi', name='vase')")


def show_result(blender: Blender) -> None:
    """Show only Gaussians in the view, and the last panel beside them."""
    blender.ask(
        "space = view()['area'].spaces.active\n"
        "space.overlay.show_overlays = space.show_gizmo = False"
    )
    blender.scroll(100)
    blender.until(f"{DRAWING}._painter is not None and {DRAWING}._painter.idle()", 120)
    blender.pause(10.0)


def show_mesh(blender: Blender) -> None:
    """Show only the vase's mesh, on its own plane, in the Rendered view, with its panel open."""
    blender.ask("call('roigs.show_alone', name='vase Mesh')")
    column, row = blender.find("roigs.export_gaussians", x=0.8)
    blender.click((column, row + SURFACE_BELOW))
    blender.ask("call('mesh.primitive_plane_add', size=1)")
    blender.ask("call('object.light_add', type='SUN', rotation=(0.8, 0, 0))")
    blender.ask("bpy.context.object.data.energy = 3")
    blender.ask("bpy.context.scene.world = bpy.context.scene.world or bpy.data.worlds.new('World')")
    blender.ask("call('roigs.select_gaussians', name='vase Mesh')")
    blender.ask("view()['area'].spaces.active.shading.type = 'RENDERED'")
    blender.scroll(100)
    blender.pause(60.0)  # Blender compiles shaders


def story(blender: Blender, out: Path, run: Path, max_side: int, *, trained: bool) -> None:
    """Go from the empty file to the result; trains it unless the run folder has one."""

    def picture(name: str, crop: str = "780x958+260+0") -> None:
        blender.screen.do("mousemove", "3", "450")
        blender.pause(2.0)
        blender.ask("view()['area'].tag_redraw()")  # panels need two redraws to find their places
        blender.pause(4.0)
        blender.screen.picture(out / f"{name}.png", crop, *COLOURS)

    prepare(blender)
    blender.ask(LOOK)
    blender.pause(1.0)
    import_demo(blender)
    select(blender, "CAMERA")
    blender.ask("[o.select_set(False) for o in bpy.context.scene.objects] and None")
    blender.ask("call('view3d.zoom', delta=1)")
    blender.ask(f"s = bpy.context.scene.roigs; s.max_side = {max_side}")
    picture("1-scene", "1040x780+0+0")
    blender.ask(f"bpy.context.scene.roigs.test_every = {8 * trained}")  # as in `make demo`

    load_boxes(blender)
    look_at_boxes(blender)
    picture("2-boxes", "1040x780+0+0")

    blender.click(blender.find("roigs.check_photos"))
    blender.until("bpy.data.objects['vase'].roigs.checked", 200)
    blender.until(f"not {BUSY}")
    blender.ask("call('roigs.look_through', photo='close/vase_00.jpg')")
    blender.pause(2.0)
    picture("3-cameras", "1040x958+0+0")

    blender.ask("bpy.context.scene.roigs.compare_photo = False")
    blender.ask("bpy.context.scene.camera.data.show_background_images = False")
    blender.ask(f"bpy.context.scene.roigs.run_dir = {str(run)!r}")
    if trained:
        blender.ask("call('roigs.load_results')", 300)
    else:
        blender.click(blender.find("roigs.train_roi", x=0.3))
        blender.until(f"{STATE}.step > 1200", 3600)
        picture("4-training")
    blender.until(f"not {BUSY}", 3600)
    show_result(blender)
    picture("5-result")

    if blender.ask("'vase Mesh' in bpy.data.objects"):  # the run already has a mesh
        show_mesh(blender)
        picture("16-mesh", "1040x958+0+0")
        blender.ask("call('roigs.show_surface', name='vase Mesh', way='GAUSSIANS')")
        blender.ask("bpy.data.batch_remove([bpy.data.objects[n] for n in ('Plane', 'Sun')])")
        blender.ask("view()['area'].spaces.active.shading.type = 'SOLID'")
        blender.ask("call('roigs.look_through', photo=bpy.context.scene.camera.name)")

    blender.ask("view()['area'].spaces.active.overlay.show_overlays = True")
    blender.ask("bpy.context.scene.roigs.compare_photo = True")
    blender.scroll(-100)
    blender.pause(5.0)
    picture("15-compare", "1040x780+0+0")

    blender.screen.do("mousemove", *(str(side // 2) for side in SIZE))  # the window opens there
    blender.ask(PREFERENCES)
    blender.screen.do("mousemove", "3", "450")  # to avoid a tooltip
    blender.pause(2.0)
    picture("6-preferences", blender.screen.place_of("Preferences"))


def main() -> int:
    """Make the pictures."""
    options = parser(__doc__)
    options.add_argument("--out", type=Path, default=REPOSITORY / "docs" / "pictures")
    options.add_argument("--max-side", type=int, default=240, help="of the photos in training")
    options.add_argument("--run", type=Path, help="a finished run of the demo: no training")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        resources = with_extension(given.blender, folder)
        screen = Screen(*SIZE)
        log = folder / "blender.log"
        try:
            with Blender(
                given.blender,
                screen,
                resources,
                log=log,
                variables={"ROIGS_ENGINE_PYTHON": os.fspath(given.engine_python)},
            ) as blender:
                if given.run:
                    shutil.copytree(given.run, folder / "run", symlinks=True)
                trained = given.run is not None
                story(blender, given.out, folder / "run", given.max_side, trained=trained)
        except Exception:
            screen.picture(given.out / "failed.png")
            print(log.read_text(encoding="utf-8") if log.exists() else "", file=sys.stderr)
            raise
        finally:
            screen.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
