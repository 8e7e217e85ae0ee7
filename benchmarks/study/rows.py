"""Definition of a row of the study: its models, settings and tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from fnmatch import fnmatchcase
from typing import Any

from roigs_engine.errors import ConfigError
from roigs_engine.run.config import RunConfig
from roigs_engine.run.presets import REFINE_SHARE, in_strategy, preset
from roigs_engine.training.config import Mechanism, TrainConfig, with_steps

TABLES = ("I", "II", "III")
BEYOND = "Beyond"
FULL_SCENE, FULL_OBJECT, MATCHED = "full-scene", "full-object", "matched"
TUNED, OBJECT_TUNED, MATCHED_TUNED = "full-scene-tuned", "full-object-tuned", "matched-tuned"
ONE_STAGE = "full-scene-tuned-one-stage"
INDEPENDENT, REFINED, JOINT, VARIANT = "independent", "refined", "joint", "variant"
EQUAL_TIME = "joint-equal-time"
TUNED_BASELINES = (TUNED, OBJECT_TUNED, MATCHED_TUNED, ONE_STAGE)
BASELINES = (FULL_SCENE, FULL_OBJECT, MATCHED, *TUNED_BASELINES)
KINDS = (*BASELINES, INDEPENDENT, REFINED, JOINT, EQUAL_TIME, VARIANT)
STRATEGY = {INDEPENDENT: INDEPENDENT, REFINED: INDEPENDENT, JOINT: JOINT, EQUAL_TIME: JOINT}
"""Kind -> strategy, if it is not the preset's."""
# Percent of the candidates that Table III selects; the presets' own; those of few rows only.
PERCENTS = (20, 40, 48, 70, 100)
OWN_PERCENT, MANY = 48, (70, 100)
# Every row of a study has the same tests and seeds, so a variant cannot set them.
FIXED = ("preset", "seed", "test_every", "evaluate_on", "baseline_densify", "selection.seed")

Change = tuple[str, Any]
"""Dotted name of a field of `RunConfig`, and its value."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """A row: it is trained and measured as a whole, and may give several lines of a table.

    Attributes:
        name: unique, a file name.
        kind: one of `KINDS`.
        tables: where it stands.
        rank: rows of a low rank come first.
        changes: what differs from the settings of its kind.
        percent: of the candidates that are selected, for Table III; 0: as its settings say.
    """

    name: str
    kind: str
    tables: tuple[str, ...]
    rank: int
    changes: tuple[Change, ...] = ()
    percent: int = 0

    @property
    def is_ablation(self) -> bool:
        """Whether its ROI stage begins from the unchanged settings' Scene-GS, as all in III do."""
        return self.tables == ("III",)

    def config(self, preset_name: str, factor: float, seed: int) -> RunConfig:
        """The settings of the row; `factor` multiplies the steps."""
        config = preset(preset_name)
        strategy = STRATEGY.get(self.kind)
        if strategy is not None and strategy != config.strategy:
            config = in_strategy(config, strategy)
        if strategy == INDEPENDENT:
            config = replace(config, refine_share=REFINE_SHARE if self.kind == REFINED else 0.0)
        config = changed(config, self.changes).scaled(factor)
        return replace(config, seed=seed, selection=replace(config.selection, seed=seed))


def all_rows(preset_name: str, variants: Iterable[Row] = ()) -> list[Row]:
    """Every row of a study, in the order of the tables."""
    own = preset(preset_name).strategy
    first = 0 if own == INDEPENDENT else 1
    rows = [
        Row(name=FULL_SCENE, kind=FULL_SCENE, tables=("I", "II", "III"), rank=0),
        Row(name=TUNED, kind=TUNED, tables=("I", "II", "III"), rank=0),
        Row(name=FULL_OBJECT, kind=FULL_OBJECT, tables=("I",), rank=1),
        Row(name=OBJECT_TUNED, kind=OBJECT_TUNED, tables=("I",), rank=1),
        Row(name=MATCHED, kind=MATCHED, tables=("I", "II"), rank=1),
        Row(name=MATCHED_TUNED, kind=MATCHED_TUNED, tables=("I", "II"), rank=0),
        Row(name=ONE_STAGE, kind=ONE_STAGE, tables=(), rank=1),
    ]
    for kind, rank in ((INDEPENDENT, first), (JOINT, 1 - first)):
        tables = ("I", "II", "III")
        rows.append(Row(name=kind, kind=kind, tables=tables, rank=rank, percent=OWN_PERCENT))
    rows.insert(-1, Row(name=REFINED, kind=REFINED, tables=("I", "II"), rank=1))
    rows.append(Row(name=EQUAL_TIME, kind=EQUAL_TIME, tables=("I", "II"), rank=1))
    return [*rows, *_ablations(), *variants]


def _ablations() -> list[Row]:
    """Table III: one thing differs from the paper's way, at each share of selected photos."""
    kinds: dict[str, tuple[str, tuple[Change, ...]]] = {
        INDEPENDENT: (INDEPENDENT, ()),
        "shuffled": (INDEPENDENT, (("roi_order", "shuffled"),)),
        "points": (INDEPENDENT, (("roi_init", "points"),)),
        "box": (INDEPENDENT, (("roi_init", "box"),)),
        **{
            method: (INDEPENDENT, (("selection.method", method),))
            for method in ("gp6", "static", "greedy", "coverage", "fvs", "random")
        },
        JOINT: (JOINT, ()),
    }
    rows = []
    for name, (kind, changes) in kinds.items():
        main = name in (INDEPENDENT, JOINT)
        for percent in reversed(PERCENTS):
            own = percent == OWN_PERCENT
            if (own and main) or (percent in MANY and not main):
                continue  # a row of Table I; or nearly all photos, whatever selects them
            share: tuple[Change, ...] = ()
            if not own:
                share = (("selection.share", percent / 100), ("selection.limit", 0))
            rows.append(
                Row(
                    name=f"{name}-{percent}",
                    kind=kind,
                    tables=("III",),
                    rank=2 if own else 3,
                    changes=(*changes, *share),
                    percent=percent,
                )
            )
    return rows


def wanted(rows: Sequence[Row], tables: Sequence[str], patterns: Sequence[str]) -> list[Row]:
    """The rows of these tables, or, with `patterns` (`gp6-*`), those they name; and the variants.

    Raises:
        ConfigError: a pattern fits no row.
    """
    if not patterns:
        return [row for row in rows if {*tables, BEYOND} & set(row.tables)]
    for pattern in patterns:
        if not any(fnmatchcase(row.name, pattern) for row in rows):
            known = ", ".join(row.name for row in rows)
            raise ConfigError(f"No row is named '{pattern}'.", f"There are: {known}.")
    return [
        row
        for row in rows
        if row.kind == VARIANT or any(fnmatchcase(row.name, pattern) for pattern in patterns)
    ]


def parse_variant(text: str, preset_name: str) -> Row:
    """A row from `NAME:FIELD=VALUE,FIELD=VALUE`.

    Raises:
        ConfigError: it is not written so, a field or value does not fit, or it trains for more
            steps than the preset.
    """
    name, separator, rest = text.partition(":")
    if not separator or not name.replace("-", "").replace("_", "").replace(".", "").isalnum():
        raise ConfigError(
            f"The variant '{text}' has no name.", "Write NAME:FIELD=VALUE,FIELD=VALUE."
        )
    if any(row.name == name for row in all_rows(preset_name)):
        raise ConfigError(f"'{name}' is a row of the tables.", "Give the variant another name.")
    config, changes = preset(preset_name), []
    for part in rest.split(","):
        field, separator, value = (piece.strip() for piece in part.partition("="))
        if not separator or field in FIXED:
            raise ConfigError(
                f"A variant cannot set '{part}'.",
                f"Write FIELD=VALUE; {', '.join(FIXED)} stay as they are.",
            )
        changes.append((field, _parsed(config, field, value)))
    steps, own = changed(config, changes).total_steps, config.total_steps
    if steps > own:
        raise ConfigError(
            f"The variant '{name}' trains for {steps} steps, the baselines for {own}.",
            "Give it as many or fewer.",
        )
    return variant(name, changes)


def variant(name: str, changes: Iterable[Change]) -> Row:
    """The preset with other settings."""
    return Row(name=name, kind=VARIANT, tables=(BEYOND,), rank=1, changes=tuple(changes))


def changed(config: RunConfig, changes: Iterable[Change]) -> RunConfig:
    """The settings with some fields set; a stage's `steps` takes its shares of steps along."""
    for name, value in changes:
        config = _set(config, name.split("."), value)
    return config


def _set(config: Any, path: Sequence[str], value: Any) -> Any:
    head, *rest = path
    if rest and (part := _mechanism(config, head)) is not None:
        return config.using(_set(part, rest, value))
    if rest:
        return replace(config, **{head: _set(getattr(config, head), rest, value)})
    if head == "steps":
        return with_steps(config, value)
    return replace(config, **{head: value})


def _mechanism(config: Any, name: str) -> Mechanism | None:
    """A stage's mechanism of that name."""
    found = config.mechanisms if isinstance(config, TrainConfig) else ()
    return next((each for each in found if each.name == name), None)


def _parsed(config: Any, name: str, text: str) -> Any:
    """The text as the field's type."""
    place = config
    for part in name.split("."):
        known = [field.name for field in fields(place)] if is_dataclass(place) else []
        known += [each.name for each in getattr(place, "mechanisms", ())]
        if part not in known:
            raise ConfigError(f"There is no setting '{name}'.", f"There are: {', '.join(known)}.")
        place = _mechanism(place, part) or getattr(place, part)
    try:
        if isinstance(place, bool):
            return {"true": True, "false": False}[text.lower()]
        if place is None:
            return None if text.lower() == "none" else int(text)
        if isinstance(place, (int, float, str)):
            return type(place)(text)
    except (KeyError, ValueError):
        pass
    raise ConfigError(f"'{name}' cannot be '{text}'.", f"It is {place!r} in the preset.")
