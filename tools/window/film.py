"""Makes the README's moving picture in a real Blender window: box an object, train, look around it.

    python -m tools.window.film BLENDER --engine-python PYTHON --frames FOLDER [--out FILE.webp]

Needs what `driver` needs, and some minutes: the demo scene is trained. Each frame is a picture of
the window, only cropped; FOLDER of `--frames` keeps them. The quality is the best that is small
enough.
"""

from __future__ import annotations

import io
import json
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path

from PIL import Image

from .driver import REPOSITORY, Blender, WindowError
from .scenario import BUSY, SCENE, STATE, addon, import_demo, parser, prepare, window

SIZE = (920, 656)
TOP = 26
"""Height of Blender's menu bar, pixels; it is cropped."""
OBJECT = "vase"
LIMIT = 1_500_000
"""Largest size of the file, bytes."""
WIDTH = 800
"""Width of the film, pixels; the window is larger, so that its panels fit."""
QUALITIES = (60, 45, 40, 36, 33, 30, 26, 20)

BOX_FRAMES, ORBIT_FRAMES = 10, 24
ORBIT = 55.0
"""Degrees by which the view turns to each side."""
TRAINING_SECONDS = 4.0
"""Least time between two frames of the training."""
TRAINING_FRAMES = 26
"""Number of frames of the training that are kept, evenly spaced."""
VIEW = (60.0, 22.0, 0.72)
"""View of the object: azimuth and elevation in degrees, distance in metres."""
FAR = 1.6
"""Distance of the view at the start of the film, metres."""
SLIDE = 4
"""Number of frames in which the object moves to the middle, after the sidebar has closed."""
ASIDE = 0.09
"""Distance beside the object at which the view aims, metres: the sidebar covers its right side."""

LOOK = """
import math, mathutils
bpy.context.preferences.view.ui_scale = 0.85
call("screen.screen_full_area", use_hide_panels=False)
space = view()["area"].spaces.active
space.overlay.show_floor = space.overlay.show_axis_x = space.overlay.show_axis_y = False
space.show_gizmo_navigate = space.show_region_toolbar = False
bpy.context.preferences.addons["bl_ext.user_default.roigs"].preferences.preview_seconds = 3
def aim(centre, azimuth, elevation, distance, aside):
    data = view()["area"].spaces.active.region_3d
    data.view_perspective = "PERSP"
    angles = math.radians(90 - elevation), 0, math.radians(azimuth)
    turned = data.view_rotation = mathutils.Euler(angles).to_quaternion()
    data.view_location = mathutils.Vector(centre) + turned @ mathutils.Vector((aside, 0, 0))
    data.view_distance = distance
def hide(kind):
    for item in bpy.context.scene.objects:
        if item.roigs.kind == kind:
            item.hide_set(True)
def fit(item, low, high, share):
    first, last = start, mathutils.Matrix.LocRotScale(
        [(a + b) / 2 for a, b in zip(low, high)], None, [(b - a) / 2 for a, b in zip(low, high)])
    item.matrix_world = mathutils.Matrix(
        [[a + (b - a) * share for a, b in zip(one, two)] for one, two in zip(first, last)])
"""
WIDTHS = f"[p.pixel for p in {addon('viewport.draw')}.painter()._pictures.values()]"
"""Code for the width of the pictures' pixels in the window's pixels; 1: at full resolution."""


@dataclass
class Film:
    """Frames of the window, and the duration of each."""

    blender: Blender
    folder: Path
    images: list[Image.Image] = field(default_factory=list)
    milliseconds: list[int] = field(default_factory=list)
    taken: int = 0

    def take(self, milliseconds: int, pause: float = 0.6) -> None:
        """Take a frame, after a pause in which Blender draws."""
        self.blender.pause(pause)
        self.taken += 1
        path = self.folder / f"{self.taken:03d}.png"
        width, height = SIZE
        self.blender.screen.picture(path, f"{width}x{height - TOP}+0+{TOP}")
        with Image.open(path) as image:
            self.images.append(image.convert("RGB"))
        self.milliseconds.append(milliseconds)

    def aim(
        self, centre: list[float], distance: float, turn: float = 0.0, aside: float = ASIDE
    ) -> None:
        """Look at a point in the world from `VIEW`, turned by `turn` degrees."""
        azimuth, elevation, _ = VIEW
        self.blender.ask(f"aim({centre}, {azimuth + turn}, {elevation}, {distance}, {aside})")

    def thin(self, first: int, count: int) -> None:
        """Keep `count` evenly spaced frames of those from `first` on."""
        last = len(self.images) - 1
        count = min(count, last - first + 1)
        kept = [first + round(k * (last - first) / max(1, count - 1)) for k in range(count)]
        self.images[first:] = [self.images[k] for k in kept]
        self.milliseconds[first:] = [self.milliseconds[k] for k in kept]

    @staticmethod
    def _scaled(image: Image.Image) -> Image.Image:
        height = round(image.height * WIDTH / image.width)
        return image.resize((WIDTH, height), Image.Resampling.LANCZOS)

    def save(self, path: Path) -> int:
        """Write the film as an animated WebP that repeats; returns its size in bytes.

        Raises:
            WindowError: it is too large at every quality.
        """
        first, *others = (self._scaled(image) for image in self.images)
        for quality in QUALITIES:
            data = io.BytesIO()
            first.save(
                data,
                "WEBP",
                save_all=True,
                append_images=others,
                duration=self.milliseconds,
                loop=0,
                quality=quality,
                method=4,
            )
            if data.tell() <= LIMIT:
                path.write_bytes(data.getvalue())
                print(f"{path}: {len(self.images)} frames, quality {quality}, {data.tell()} bytes")
                return data.tell()
        raise WindowError(f"{len(self.images)} frames are more than {LIMIT:,} bytes")


def box(film: Film, low: list[float], high: list[float]) -> None:
    """Add a box, and move it onto the object."""
    blender = film.blender
    middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    film.aim(middle, FAR)
    film.take(900, 2.0)
    blender.click(blender.find("roigs.add_roi"))
    item = "next(o for o in bpy.context.scene.objects if o.roigs.kind == 'ROI')"
    blender.until("any(o.roigs.kind == 'ROI' for o in bpy.context.scene.objects)")
    blender.ask(f"start = {item}.matrix_world.copy(); {item}.name = {OBJECT!r}")
    blender.screen.do("mousemove", "3", "450")
    film.take(500)
    for k in range(1, BOX_FRAMES + 1):
        share = (1 - math.cos(math.pi * k / BOX_FRAMES)) / 2
        film.aim(middle, FAR + (VIEW[2] - FAR) * share)
        blender.ask(f"fit({item}, {low}, {high}, {share})")
        film.take(90)
    film.milliseconds[-1] = 900


def train(film: Film) -> None:
    """Train, and take a frame every few seconds."""
    blender = film.blender
    blender.click(blender.find("roigs.train_roi", x=0.3))
    blender.screen.do("mousemove", "3", "450")
    blender.until(f"{STATE}.step > 0", 600)
    blender.scroll(6)
    blender.screen.do("mousemove", "3", "450")
    blender.ask("hide('CAMERA')")
    first = len(film.images)
    while blender.ask(BUSY):
        film.take(140, TRAINING_SECONDS)
    film.thin(first, TRAINING_FRAMES)
    film.milliseconds[-1] = 700
    error = blender.ask(f"{STATE}.error")
    if error:
        raise WindowError(str(error))


def orbit(film: Film, middle: list[float]) -> None:
    """Look around the object."""
    film.blender.ask(
        "space = view()['area'].spaces.active\n"
        "space.show_region_ui = space.overlay.show_overlays = space.show_gizmo = False"
    )
    for k in range(ORBIT_FRAMES):
        angle = ORBIT * math.sin(2 * math.pi * k / ORBIT_FRAMES)
        film.aim(middle, VIEW[2], angle, ASIDE * (1 - min(1.0, k / SLIDE)))
        film.blender.pause(1.0)
        film.blender.until(f"set({WIDTHS}) == {{1}}", 120)
        film.take(100)


def main() -> int:
    """Make the film."""
    options = parser(__doc__)
    options.add_argument("--out", type=Path, default=REPOSITORY / "docs" / "pictures" / "film.webp")
    options.add_argument("--frames", type=Path, required=True, help="folder for the frames")
    options.add_argument("--max-side", type=int, default=640, help="of the photos in training")
    given = options.parse_args()
    records = json.loads((SCENE / "rois.json").read_text(encoding="utf-8"))["rois"]
    record = next(record for record in records if record["name"] == OBJECT)
    low, high = record["min"], record["max"]
    with window(given, *SIZE) as blender:
        film = Film(blender, given.frames)
        prepare(blender)
        blender.ask(LOOK)
        import_demo(blender)
        blender.ask("[o.select_set(False) for o in bpy.context.scene.objects] and None")
        run = given.frames / "run"
        blender.ask(
            f"s = bpy.context.scene.roigs; s.max_side = {given.max_side}; s.run_dir = {str(run)!r}"
        )
        box(film, low, high)
        train(film)
        orbit(film, [(a + b) / 2 for a, b in zip(low, high, strict=True)])
    film.save(given.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
