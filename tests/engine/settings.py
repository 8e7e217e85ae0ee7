"""Settings of stages for the tests of several packages."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from roigs_engine.training.config import Mechanism, TrainConfig


def adjusted(config: TrainConfig, kind: type[Mechanism], **changes: Any) -> TrainConfig:
    """The config with other settings of one of its mechanisms."""
    return config.using(replace(config.of(kind), **changes))


def without(config: TrainConfig, *kinds: type[Mechanism]) -> TrainConfig:
    """The config without some of its mechanisms."""
    kept = tuple(each for each in config.mechanisms if not isinstance(each, kinds))
    return replace(config, mechanisms=kept)
