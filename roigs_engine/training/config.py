"""Settings of a training stage: a small core and its mechanisms, as frozen values; torch-free.

The core is standard 3DGS without densification (Kerbl et al. 2023). Everything else is a
*mechanism*: a frozen dataclass with its own settings, in a separate file (`mechanisms/`). A stage
lists its mechanisms in the order in which they act. notebook/README.md has the measurements.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats.targets import PLAIN, TARGETS, Target
from ..model.roi import OrientedBox
from ..model.scene import PosedImage

if TYPE_CHECKING:
    from .running import Running, Training
    from .stage_data import StageData
    from .state_reader import StateReader

SCALES, SHARE, INTERVAL = "scales", "share", "interval"  # keys and values of a field's metadata
PLANNED, LIMITED = "planned", "limited"
LIMITS: dict[str, tuple[Callable[[float, float], bool], str]] = {
    "least": (operator.ge, "{:,.12g} or more"),
    "above": (operator.gt, "more than {:,.12g}"),
    "most": (operator.le, "at most {:,.12g}"),
    "below": (operator.lt, "less than {:,.12g}"),
}


def limited(default: Any = MISSING, **limits: float) -> Any:
    """Declare a field with limits, keys of `LIMITS`. None is always allowed."""
    return field(default=default, metadata={LIMITED: limits})


def check_limits(settings: Any, owner: str = "") -> None:
    """Raise ConfigError if a `limited` field of a dataclass is out of its limits."""
    for each in fields(settings):
        value, limits = getattr(settings, each.name), each.metadata.get(LIMITED, {})
        if value is not None and not all(LIMITS[key][0](value, at) for key, at in limits.items()):
            allowed = ", and ".join(LIMITS[key][1].format(at) for key, at in limits.items())
            raise ConfigError(f"{owner}{each.name} is {value:g}.", f"Use {allowed}.")


def share_of_steps(default: int, **limits: float) -> Any:
    """Declare a `limited` number of steps that scales with the stage's steps (`with_steps`)."""
    return field(default=default, metadata={SCALES: SHARE, LIMITED: limits})


def interval(default: int, **limits: float) -> Any:
    """Declare a `limited` number of steps that scales only in a `miniature`; 0 is off."""
    return field(default=default, metadata={SCALES: INTERVAL, LIMITED: limits})


def planned(default: Any) -> Any:
    """Declare a field that the plan sets (`Mechanism.planned`); it is no setting of a run."""
    return field(default=default, metadata={PLANNED: True})


@dataclass(frozen=True, kw_only=True)
class PlannedViews:
    """The photos and boxes of a planned stage; `seen` returns all training photos of a box."""

    images: Sequence[PosedImage]
    rois: Sequence[OrientedBox]
    seen: Callable[[OrientedBox], Sequence[PosedImage]]
    context: Context = QUIET

    @property
    def rows_seeing(self) -> tuple[int, ...]:
        """Return the row numbers of the `images` that see any of the boxes."""
        names = {image.name for roi in self.rois for image in self.seen(roi)}
        return tuple(row for row, image in enumerate(self.images) if image.name in names)


@dataclass(frozen=True, kw_only=True)
class Mechanism:
    """One part of a stage's training: its settings and its hooks.

    All methods do nothing by default. Modules of mechanisms import torch only when it is used.

    Attributes:
        name: stable; in manifests, fingerprints and checkpoints.
        needs: mechanisms that it requires.
        uses_object_masks: whether its results depend on the masks of the boxes' objects.
    """

    name: ClassVar[str] = ""
    needs: ClassVar[tuple[type[Mechanism], ...]] = ()
    uses_object_masks: ClassVar[bool] = False

    def check(self, config: TrainConfig) -> None:
        """Raise ConfigError if a setting is out of its limits, or another mechanism is missing."""
        check_limits(self, f"{self.name}: ")
        for kind in self.needs:
            config.of(kind, self)

    def scaled(self, steps: int, before: int, *, intervals: bool) -> Self:
        """Return the settings for another number of steps of the stage than `before`.

        With `intervals`, intervals scale too; one that is on keeps at least one step.
        """
        changes: dict[str, Any] = {}
        for each in fields(self):
            value, how = getattr(self, each.name), each.metadata.get(SCALES)
            if how == SHARE:
                changes[each.name] = round(value * steps / before)
            elif how == INTERVAL and intervals and value:
                changes[each.name] = max(1, round(value * steps / before))
        return replace(self, **changes)

    def planned(self, config: TrainConfig, views: PlannedViews) -> TrainConfig:
        """Return the config with settings that depend on photos and boxes, before any training."""
        return config

    def measured(self, config: TrainConfig, data: StageData, context: Context) -> TrainConfig:
        """Return the config with settings from the photos' pixels, before the first step."""
        return config

    def more_points(self, data: StageData, context: Context) -> tuple[Any, Any] | None:
        """Return points to add to the sparse ones: (B, 3) positions, (B, 3) uint8 colours."""
        return None

    def acts(self, config: TrainConfig) -> bool:
        """Whether it does anything during the training of this config."""
        return type(self).begin is not Mechanism.begin

    def begin(self, config: TrainConfig, training: Training) -> Running:
        """Create the running part of the mechanism; called if it `acts`.

        `training` has the stage's first model, or that of a checkpoint.
        """
        raise NotImplementedError

    def check_state(self, state: StateReader) -> None:
        """Raise ValueError unless training could have written this checkpoint's state."""
        state.tensors({})


Part = TypeVar("Part", bound=Mechanism)


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """One training stage; steps count from 0. The defaults are 3DGS's.

    Attributes:
        steps: optimisation steps, one photo each.
        sh_degree, sh_start, sh_every: highest SH degree, degree at the start, steps between raises.
        ssim_weight: weight w of 1 - SSIM in the loss; L1 has 1 - w.
        lr_means, lr_means_final: first and last position learning rate, in units of the scene
            extent; exponential decay.
        lr_sh0, lr_shN, lr_opacities, lr_scales, lr_quats: Adam's learning rates.
        made_for: name of the target (`TARGETS`) for which the Gaussians are drawn.
        mechanisms: of the stage, in the order in which they act.
    """

    steps: int
    sh_degree: int = 3
    sh_start: int = 0
    sh_every: int = 1000
    ssim_weight: float = 0.2
    lr_means: float = 1.6e-4
    lr_means_final: float = 1.6e-6
    lr_sh0: float = 2.5e-3
    lr_shN: float = 1.25e-4  # noqa: N815 - the field's name
    lr_opacities: float = 0.05
    lr_scales: float = 5e-3
    lr_quats: float = 1e-3
    made_for: str = PLAIN.name
    mechanisms: tuple[Mechanism, ...] = ()

    def __post_init__(self) -> None:
        if self.made_for not in TARGETS:
            known = ", ".join(TARGETS)
            raise ConfigError(f"made_for is '{self.made_for}'.", f"Use one of {known}.")
        for index, mechanism in enumerate(self.mechanisms):
            if any(_alike(mechanism, other) for other in self.mechanisms[:index]):
                raise ConfigError(f"The stage has two of {mechanism.name}.", "Leave out one.")
            mechanism.check(self)

    @property
    def target(self) -> Target:
        """Return the target with the name `made_for`."""
        return TARGETS[self.made_for]

    def get(self, kind: type[Part]) -> Part | None:
        """Return the stage's mechanism of this class, or None."""
        return next((each for each in self.mechanisms if isinstance(each, kind)), None)

    def of(self, kind: type[Part], needed_by: Mechanism | None = None) -> Part:
        """Return the stage's mechanism of this class; ConfigError if it has none."""
        found = self.get(kind)
        if found is None:
            who = "The stage" if needed_by is None else needed_by.name
            raise ConfigError(
                f"{who} needs {kind.name}, which the stage does not use.",
                f"Add {kind.__name__} to its mechanisms.",
            )
        return found

    def using(self, *mechanisms: Mechanism) -> TrainConfig:
        """Return the config with these mechanisms; each replaces one of its kind or is appended."""
        listed = list(self.mechanisms)
        for new in mechanisms:
            places = [place for place, old in enumerate(listed) if _alike(new, old)]
            if places:
                listed[places[0]] = new
            else:
                listed.append(new)
        return replace(self, mechanisms=tuple(listed))

    def chosen(self, *kinds: type[Mechanism]) -> tuple[Mechanism, ...]:
        """Return its mechanisms of these classes, in their order."""
        return tuple(each for each in self.mechanisms if isinstance(each, kinds))

    def only(self, *kinds: type[Mechanism]) -> TrainConfig:
        """Return the config with only its mechanisms of these classes, in their order."""
        return replace(self, mechanisms=self.chosen(*kinds))

    def position_learning_rate(self, step: int) -> float:
        """Return the position learning rate at a step, in units of the scene extent."""
        t = min(step / max(self.steps, 1), 1.0)
        return math.exp((1 - t) * math.log(self.lr_means) + t * math.log(self.lr_means_final))

    def degree(self, step: int) -> int:
        return min(self.sh_degree, self.sh_start + step // max(self.sh_every, 1))

    def planned(self, views: PlannedViews) -> TrainConfig:
        config = self
        for mechanism in self.mechanisms:
            config = mechanism.planned(config, views)
        return config

    def measured(self, data: StageData, context: Context) -> TrainConfig:
        config = self
        for mechanism in self.mechanisms:
            config = mechanism.measured(config, data, context)
        return config

    def to_dict(self, *, planned: bool = False) -> dict[str, Any]:
        """Return plain values for JSON, mechanisms by name; `planned` adds the plan's settings."""
        record = {each.name: getattr(self, each.name) for each in fields(self)}
        record["mechanisms"] = {
            mechanism.name: {
                each.name: getattr(mechanism, each.name)
                for each in fields(mechanism)
                if planned or PLANNED not in each.metadata
            }
            for mechanism in self.mechanisms
        }
        return record


def _alike(one: Mechanism, other: Mechanism) -> bool:
    """Whether one mechanism's class is the other's or derived from it: a stage has only one."""
    return isinstance(one, type(other)) or isinstance(other, type(one))


def with_steps(config: TrainConfig, steps: int) -> TrainConfig:
    """Return the config with `steps` steps; the same shares of them densify and are averaged.

    Intervals do not scale: Adam and the statistics need a fixed number of steps. `miniature` scales
    them too.
    """
    return _scaled(config, steps, intervals=False)


def miniature(config: TrainConfig, steps: int) -> TrainConfig:
    """Return the config with `steps` steps and its whole schedule in proportion.

    It densifies, raises the SH degree and resets opacities as often as the full schedule, up to
    rounding. An interval keeps at least one step; an interval of 0 stays 0.
    """
    every = max(1, round(config.sh_every * steps / config.steps)) if config.sh_every else 0
    return replace(_scaled(config, steps, intervals=True), sh_every=every)


def _scaled(config: TrainConfig, steps: int, *, intervals: bool) -> TrainConfig:
    mechanisms = tuple(
        each.scaled(steps, config.steps, intervals=intervals) for each in config.mechanisms
    )
    return replace(config, steps=steps, mechanisms=mechanisms)
