"""Extra content of a web page: a second model, places to fly to, photos, meshes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...context import Context
from ...errors import ConfigError
from ...exchange import formats
from ...exchange.arrays import turn
from ...model.roi import load_rois
from ...requests.models import Convert
from .axes import SCENE_UP, to_home, to_upright, turned
from .reading import cropped, read_arrays, refuse_own_inputs, shortened

if TYPE_CHECKING:
    from ...exchange.arrays import Arrays
    from ...exchange.page import Extras
    from .models import Model


def refuse_page_options(request: Convert, *, plain: bool) -> None:
    """Raise ConfigError if an option of pages is given for another format.

    With `plain` (viewers without anti-aliasing), other formats may have --scene, too.
    """
    given = {
        "--title": request.title,
        "--fly-to": request.fly_to,
        "--before": request.before,
        "--mesh": request.mesh or None,
        "--scene": None if plain else request.page_scene,
    }
    if request.out.suffix.lower() != formats.PAGE:
        for option in (name for name, value in given.items() if value is not None):
            also = " and --plain" if option == "--scene" else ""
            raise ConfigError(
                f"{option} is for web pages{also} alone.",
                f"Leave it out, or let OUT end in {formats.PAGE}.",
            )
    elif request.page_scene is not None and request.from_up is not None:
        raise ConfigError("--scene and --from-up both set the up axis.", "Leave out one.")


def compared(request: Convert, up: str, model: Model, context: Context) -> Arrays | None:
    """Return the model of `--before`, in the frame of the first one; None if not given."""
    if request.before is None:
        return None
    refuse_own_inputs(request, request.before)
    upright = to_upright(request, request.before, context)
    home = to_home(request, request.before, upright)
    own = turn(SCENE_UP, request.up or up) @ upright
    matrix = model.matrix @ home if model.upright else own
    arrays = cropped(read_arrays(request.before, context), request, home)
    return shortened(turned(arrays, matrix), request)


def page_extras(request: Convert, before: Arrays | None, model: Model, context: Context) -> Extras:
    """The extra content of a page, with boxes and photos rotated like the model."""
    from ...exchange.page import Ball, Extras

    matrix, poses = model.matrix, model.poses
    places = []
    for box in load_rois(request.fly_to) if request.fly_to else []:
        centre = matrix[:3, :3] @ box.centre + matrix[:3, 3]
        ball = Ball(centre=centre, radius=float(np.linalg.norm(box.half_extents)))
        places.append((box.name, ball))
    meshes = []
    for file in request.mesh:
        from ...surface.files import page_meshes

        refuse_own_inputs(request, file)
        meshes += page_meshes(file, matrix, context)
    shown = None if request.before is None else formats.target_of(request.before)
    return Extras(
        title=request.title or "",
        places=places,
        before=before,
        before_antialiased=shown is not None and shown.antialiased,
        poses=None if poses is None else poses @ np.linalg.inv(matrix),
        meshes=meshes,
        photo_focal=model.photo_focal,
    )
