"""Draws Gaussians in the 3D viewport.

| module | what |
|---|---|
| `worker` | a thread that does the newest task of each name |
| `sorting` | back-to-front order |
| `packing` | several clouds as one set of texel arrays |
| `objects` | which objects are drawn |
| `shaders` | the GPU programs, from `shaders/` |
| `targets` | pictures on the GPU: the splats' own, and the scene's depth |
| `painter` | keeps the sets and orders on the GPU, and draws them |
| `handler` | what Blender calls for each viewport |
| `draw` | the Gaussians in the viewport, `draw_view` for any other picture |
| `points` | the sparse points in their colours |
| `marks` | boxes and chosen cameras as coloured lines |

The first three need numpy alone. Nothing of `gpu` is built before the first picture.
"""

from __future__ import annotations


def register() -> None:
    """Start to draw; nothing in background mode."""
    from . import draw, marks, points

    points.register()  # before what looks at its depth
    draw.register()
    marks.register()


def problems() -> dict[str, str]:
    """Path -> why it cannot be drawn; path "" for what concerns all."""
    from . import draw, points

    own = {"": points.problem()} if points.problem() else {}
    return {**own, **draw.problems()}


def unregister() -> None:
    """Stop to draw and free everything."""
    from . import draw, marks, points

    marks.unregister()
    draw.unregister()
    points.unregister()
