"""The parts of a batch, each for one engine process, and their dependencies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from ..model.scene import PosedImage
from ..run.plan import Plan, Stage

PREPARE, WHOLE = "prepare", "all"
Key = tuple[str, str]


@dataclass(frozen=True, kw_only=True)
class Staging:
    """The places of a scene's files, if they are on a store."""

    url: str  # of the batch's folder
    base: str  # the same folder on the planning machine; the command line names it
    options: dict[str, Any]  # the scene's, for its options file; files at addresses are copied


@dataclass(frozen=True, kw_only=True)
class Part:
    """Work for one process."""

    scene: str  # name of the scene in the table, and of its run folder
    name: str  # unique in the scene: `prepare`, a stage, `all`, or an output's suffix
    argv: tuple[str, ...]  # the engine's command line
    needs: tuple[str, ...] = ()  # names of the scene's parts that must be done before
    work: float = 0.0  # steps times megapixels, to compare parts
    memory: int = 0  # most bytes that it needs
    gpu: bool = False  # whether it uses a GPU if there is one
    stages: tuple[tuple[str, float], ...] = ()  # name and work of its stages, in order
    staging: Staging | None = None  # the places of its files, if they are on a store

    @property
    def key(self) -> Key:
        """Identifies the part in the batch."""
        return self.scene, self.name

    @property
    def label(self) -> str:
        """Its name for users."""
        return self.scene if self.name == WHOLE else f"{self.scene}: {self.name}"


@dataclass(frozen=True, kw_only=True)
class ScenePlan:
    """The work for one scene."""

    name: str  # name in the table
    objects: tuple[str, ...]  # names of its boxes
    steps: tuple[int, ...]  # steps of each stage of its run; empty for photos without a model
    parts: tuple[Part, ...]  # each after the parts that it needs
    done: bool = False  # whether an earlier batch has finished it

    @cached_property
    def work(self) -> float:
        """The work of all parts."""
        return sum(part.work for part in self.parts)


def stage_work(stage: Stage) -> float:
    """Steps times megapixels of the largest photo."""
    return stage.config.steps * megapixels(stage.images)


def megapixels(images: Sequence[PosedImage]) -> float:
    """Megapixels of the largest photo; 0 without photos."""
    return max((i.camera.width * i.camera.height for i in images), default=0) / 1e6


def chains(plan: Plan) -> list[tuple[Stage, ...]]:
    """Group the plan's stages into chains, in which only the next stage needs each stage.

    A chain can run as one part: no other stage can start before it ends.
    """
    users: dict[str, list[str]] = {}
    for stage in plan.stages:
        for needed in stage.start.stages:
            users.setdefault(needed.name, []).append(stage.name)
    found: dict[str, list[Stage]] = {}  # last stage -> the chain
    for stage in plan.stages:
        names = {needed.name for needed in stage.start.stages}
        only = next(iter(names)) if len(names) == 1 else ""
        before = found.pop(only) if only in found and set(users[only]) == {stage.name} else []
        found[stage.name] = [*before, stage]
    return [tuple(chain) for chain in found.values()]


def cuts(plan: Plan) -> list[tuple[Stage, ...]]:
    """The chains of a plan, for several processes; empty if one process is as fast.

    Splitting only helps if two chains can run at the same time.
    """
    found = chains(plan)
    depth: dict[str, int] = {}
    for chain in found:
        depth[chain[-1].name] = 1 + max((depth[name] for name in needs(chain)), default=0)
    return found if len(set(depth.values())) < len(depth) else []


def needs(chain: Sequence[Stage]) -> tuple[str, ...]:
    """The chains that a chain waits for, named by their last stages."""
    return tuple(dict.fromkeys(needed.name for needed in chain[0].start.stages))


def works(stages: Sequence[Stage]) -> tuple[tuple[str, float], ...]:
    """Name and work of stages."""
    return tuple((stage.name, stage_work(stage)) for stage in stages)


def costs_after(parts: Sequence[Part], costs: Mapping[Key, float]) -> dict[Key, float]:
    """For each part of a scene, the cost after it, on the longest path to the scene's end."""
    found: dict[Key, float] = {}
    for part in reversed(parts):
        later = [costs[p.key] + found[p.key] for p in parts if part.name in p.needs]
        found[part.key] = max(later, default=0.0)
    return found
