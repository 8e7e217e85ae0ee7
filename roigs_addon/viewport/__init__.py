"""Draws Gaussians in the 3D viewport.

| module | content |
|---|---|
| `sorting` | back-to-front order |
| `packing` | several clouds as one set of texel arrays |
| `objects` | the objects to draw |
| `placed` | the objects on the GPU: their order and display |
| `levels_in_view` | the objects' levels of detail |
| `view` | the viewpoint; the camera's picture in it |
| `shaders` | the GPU programs, from `shaders/` |
| `targets` | images on the GPU: the splats' own, and the scene's depth |
| `pace` | the resolution of a view while it changes |
| `painter` | keeps the sets and orders on the GPU, and draws them |
| `handler` | the draw handler for each viewport |
| `draw` | the Gaussians in the viewport |
| `picture` | the viewport as a picture |
| `points` | the sparse points in their colours |
| `chosen` | Gaussians that a clean-up tool has selected |
| `photo_wipe` | a photo beside the Gaussians, over the view through its camera |
| `photo_overlay` | a photo with strokes and a mask, over the view through its camera |
| `marks` | boxes, chosen and excluded cameras as coloured lines |

`sorting`, `packing` and `pace` need no Blender. Nothing is created on the GPU before the first
image is drawn.
"""

from __future__ import annotations


def register() -> None:
    """Start drawing; does nothing in background mode."""
    from . import chosen, draw, marks, photo_overlay, photo_wipe, points

    points.register()  # first, because the others read its depth
    draw.register()
    chosen.register()
    marks.register()
    photo_overlay.register()
    photo_wipe.register()


def problems() -> dict[str, str]:
    """Return path -> why it cannot be drawn; path "" is for problems of all objects."""
    import bpy

    from ..scene import edits
    from . import chosen, draw, marks, photo_wipe, points

    marking = marks.problem() or chosen.problem() or photo_wipe.problem()
    edited = edits.problem(bpy.data.objects) or edits.remark(bpy.data.objects)
    own = points.problem() or marking or edited
    return {**({"": own} if own else {}), **draw.problems()}


def unregister() -> None:
    """Stop drawing and free everything."""
    from . import chosen, draw, marks, photo_overlay, photo_wipe, points

    photo_wipe.unregister()
    photo_overlay.unregister()
    marks.unregister()
    chosen.unregister()
    draw.unregister()
    points.unregister()
