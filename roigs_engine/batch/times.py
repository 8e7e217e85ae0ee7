"""Estimates the time of a batch, from a few measured steps of each kind of stage."""

from __future__ import annotations

import heapq
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ..formats.text import json_digest
from ..run.plan import Plan, Stage
from ..training.config import miniature
from .parts import WHOLE, Key, Part, ScenePlan, chains, costs_after, stage_work

if TYPE_CHECKING:
    from ..context import Context
    from ..run.definition import Run

START = 4.0  # seconds until an engine trains: it loads Python, torch and the scene
ALIKE = 4  # stages whose points and photos differ by less than 1 / ALIKE share a measurement


@dataclass
class Times:
    """Seconds of parts; stages with similar settings, photos and points are measured once.

    `measured` counts the measurements.
    """

    measured: int = 0
    _rates: dict[str, float] = field(default_factory=dict)

    def of_scene(
        self, scene: ScenePlan, run: Run | None, plan: Plan | None, context: Context
    ) -> dict[Key, float]:
        """Seconds of each unfinished part, with all cores, on the device of the context.

        Photos without a model (`run` and `plan` are None) count as nothing.
        """
        found = {part.key: 0.0 if scene.done else START for part in scene.parts}
        if run is None or plan is None or scene.done or (scene.name, WHOLE) not in found:
            return found
        from ..run.forecast import forecast

        points = len(run.train_scene.points)
        kinds = {stage.name: _kind(stage, points) for stage in plan.stages}
        if not kinds.keys() <= {n for n, kind in kinds.items() if kind in self._rates}:
            for expected in forecast(run, plan, context).stages:
                work = max(stage_work(expected.stage), 1e-9)
                self._rates[kinds[expected.stage.name]] = expected.seconds / work
                self.measured += 1
        for chain in chains(plan):
            seconds = sum(self._rates[kinds[s.name]] * stage_work(s) for s in chain)
            key = (scene.name, chain[-1].name)
            found[key if key in found else (scene.name, WHOLE)] += seconds
        return found


def _kind(stage: Stage, points: int) -> str:
    """A key that is equal for stages whose steps take about the same time."""
    config = miniature(stage.config, 0).to_dict()
    sizes = max(i.camera.width * i.camera.height for i in stage.images), points
    rough = [round(ALIKE * math.log(max(size, 1))) for size in sizes]
    return json_digest([config, rough, len(stage.rois)])


def makespan(scenes: Sequence[Sequence[Part]], seconds: Mapping[Key, float], workers: int) -> float:
    """Seconds until all parts of the scenes are done, on `workers` equal workers."""
    needs = {p.key: {(p.scene, name) for name in p.needs} for parts in scenes for p in parts}
    after: dict[Key, float] = {}
    for parts in scenes:
        after |= costs_after(parts, seconds)
    ready = [(-seconds[key] - after[key], key) for key, needed in needs.items() if not needed]
    heapq.heapify(ready)
    running: list[tuple[float, Key]] = []
    now = 0.0
    while ready or running:
        while ready and len(running) < workers:
            _, key = heapq.heappop(ready)
            heapq.heappush(running, (now + seconds[key], key))
        now, ended = heapq.heappop(running)
        for key, needed in needs.items():
            if ended in needed:
                needed.remove(ended)
                if not needed:
                    heapq.heappush(ready, (-seconds[key] - after[key], key))
    return now
