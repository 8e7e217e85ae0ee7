"""The parts of a batch: pieces of work for one engine process each, and what each waits for."""

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
    """Where the files of a scene's parts are, if they are on a store.

    Attributes:
        url: of the batch's folder.
        base: the same folder on the machine that planned; the command line names it.
        options: of the scene, for its options file; addresses in them are copied here.
    """

    url: str
    base: str
    options: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Part:
    """Work for one process.

    Attributes:
        scene: the scene's name in the table, and of its run folder.
        name: unique in the scene: `prepare`, a stage, `all`, or an output's suffix.
        argv: the engine's command line.
        needs: names of the scene's parts that must be done before.
        work: steps times megapixels, to compare parts with one another.
        memory: bytes that it may take.
        gpu: whether it uses a GPU where there is one.
        stages: name and work of the stages that it trains, in order.
        staging: where its files are, if they are on a store.
    """

    scene: str
    name: str
    argv: tuple[str, ...]
    needs: tuple[str, ...] = ()
    work: float = 0.0
    memory: int = 0
    gpu: bool = False
    stages: tuple[tuple[str, float], ...] = ()
    staging: Staging | None = None

    @property
    def key(self) -> Key:
        """Unique in the batch."""
        return self.scene, self.name

    @property
    def label(self) -> str:
        """For people."""
        return self.scene if self.name == WHOLE else f"{self.scene}: {self.name}"


@dataclass(frozen=True, kw_only=True)
class ScenePlan:
    """What is to be done for one scene.

    Attributes:
        name: of the scene in the table.
        objects: names of its boxes.
        steps: of each stage of its run; empty for photos without a model.
        parts: in an order in which they can be done.
        done: whether an earlier batch has done all of it.
    """

    name: str
    objects: tuple[str, ...]
    steps: tuple[int, ...]
    parts: tuple[Part, ...]
    done: bool = False

    @cached_property
    def work(self) -> float:
        """Of all parts."""
        return sum(part.work for part in self.parts)


def stage_work(stage: Stage) -> float:
    """Steps times megapixels of the largest photo, in each size."""
    small = sum(map(stage.config.is_small, range(stage.config.steps)))
    return (stage.config.steps - small) * megapixels(stage.images) + small * megapixels(
        stage.small_images
    )


def megapixels(images: Sequence[PosedImage]) -> float:
    """Of the largest photo; 0: there is none."""
    return max((i.camera.width * i.camera.height for i in images), default=0) / 1e6


def chains(plan: Plan) -> list[tuple[Stage, ...]]:
    """The plan's stages in chains: within one, each stage serves the next alone.

    A chain is as good as one stage: nothing else can start before it ends.
    """
    users: dict[str, list[str]] = {}
    for stage in plan.stages:
        for needed in stage.start.stages:
            users.setdefault(needed.name, []).append(stage.name)
    found: dict[str, list[Stage]] = {}  # by the last stage
    for stage in plan.stages:
        names = {needed.name for needed in stage.start.stages}
        only = next(iter(names)) if len(names) == 1 else ""
        before = found.pop(only) if only in found and set(users[only]) == {stage.name} else []
        found[stage.name] = [*before, stage]
    return [tuple(chain) for chain in found.values()]


def cuts(plan: Plan) -> list[tuple[Stage, ...]]:
    """The chains of a plan, for several processes; empty if one process does as well.

    Splitting pays only if two can work side by side.
    """
    found = chains(plan)
    depth: dict[str, int] = {}
    for chain in found:
        depth[chain[-1].name] = 1 + max((depth[name] for name in needs(chain)), default=0)
    return found if len(set(depth.values())) < len(depth) else []


def needs(chain: Sequence[Stage]) -> tuple[str, ...]:
    """The chains that one waits for, by their last stages, which alone serve others."""
    return tuple(dict.fromkeys(needed.name for needed in chain[0].start.stages))


def works(stages: Sequence[Stage]) -> tuple[tuple[str, float], ...]:
    """Name and work of stages."""
    return tuple((stage.name, stage_work(stage)) for stage in stages)


def costs_after(parts: Sequence[Part], costs: Mapping[Key, float]) -> dict[Key, float]:
    """The costs of what waits for each part of a scene, on the longest way to the scene's end."""
    found: dict[Key, float] = {}
    for part in reversed(parts):
        later = [costs[p.key] + found[p.key] for p in parts if part.name in p.needs]
        found[part.key] = max(later, default=0.0)
    return found
