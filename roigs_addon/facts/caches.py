"""Clears the cached facts after a job, and when another file is loaded."""

from __future__ import annotations

import bpy

from ..blender import persistent
from ..jobs import current, estimate_job
from . import (
    engine_ability,
    photo_names,
    photo_pictures,
    point_counts,
    reconstructions,
    run_facts,
    weak_photos,
)


@persistent
def forget(*_: object) -> None:
    """Clear all caches."""
    run_facts.forget()
    reconstructions.forget()
    photo_names.forget()
    photo_pictures.forget()
    point_counts.forget()
    weak_photos.forget()


def register() -> None:
    """Clear the caches after each job and each load."""
    bpy.app.handlers.load_post.append(forget)
    current.on_end.append(forget)


def unregister() -> None:
    """Remove the handlers, and end threads and timers."""
    forget()
    point_counts.close()
    estimate_job.forget()
    engine_ability.timer.stop()
    current.on_end.remove(forget)
    bpy.app.handlers.load_post.remove(forget)
