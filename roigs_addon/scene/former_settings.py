"""Settings that a file of an earlier version does not have, where the default would be wrong."""

from __future__ import annotations

import bpy

from ..blender import following, persistent
from ..engine.presets import PAPER_DEFAULTS
from ..engine.training_steps import PAPER
from ..properties import scene_props


@persistent
def _after_load(*_: object) -> None:
    """The paper's preset stays the paper's way; with others, anti-aliasing is on from now on."""
    for scene in bpy.data.scenes:
        props = scene_props(scene)
        if scene.library is None and props.preset == PAPER and not props.is_paper:
            props.is_paper = True
            props.antialiased = bool(PAPER_DEFAULTS["antialiased"])


register, unregister = following(("load_post", _after_load))
