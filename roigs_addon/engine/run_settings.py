"""The settings that a training was asked for: compared with others, and in words. No bpy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from ..shared import EngineError, files, run_files, text
from .training_steps import PRESET_STEPS

NAMED = 2
"""Photos that are named."""
BOX_SETTINGS = ("method", "count")
"""They decide the boxes' photos only."""


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """What decides a result beside boxes and photo lists; None: not known.

    Attributes:
        preset, strategy, method, count, seed, test_every: as the engine's options.
        max_side, steps_factor, antialiased: likewise.
        steps: of the scene and the boxes: those of a preset may change between versions.
        exclude: names of the photos that are left out.
        scene, images: names of the folders. Their paths change when a project is moved.
    """

    preset: str | None = None
    max_side: int | None = None
    steps_factor: float | None = None
    steps: int | None = None
    strategy: str | None = None
    antialiased: bool | None = None
    method: str | None = None
    count: int | None = None
    seed: int | None = None
    test_every: int | None = None
    exclude: tuple[str, ...] | None = None
    scene: str | None = None
    images: str | None = None

    @classmethod
    def from_options(
        cls, values: Mapping[str, Any], config: Mapping[str, Any] | None = None
    ) -> RunSettings:
        """The settings of an options file.

        Args:
            values: of the file.
            config: of the manifest, for what the file leaves to the preset.
        """
        config = config or {}
        selection = config.get("selection")
        chosen = selection if isinstance(selection, dict) else {}
        known = {**chosen, **_of_stages(config), **config, **values}
        names = [field.name for field in fields(cls) if field.name not in ("exclude", "count")]
        found = {name: _plain(known.get(name)) for name in names}
        if values:
            found["steps_factor"] = found["steps_factor"] or 1.0
            found["images"] = found["images"] or ""
        found |= {key: Path(found[key]).name for key in ("scene", "images") if found[key]}
        exclude, count = values.get("exclude"), known.get("count")
        listed = exclude if isinstance(exclude, list) else []
        return cls(
            **found,
            exclude=tuple(sorted(map(str, listed))) if values else None,
            count=(count if isinstance(count, int) else 0) if known else None,
        )


def _of_stages(config: Mapping[str, Any]) -> dict[str, Any]:
    """What a manifest says of the stages. Before there was anti-aliasing, none had it."""
    scene, boxes = config.get("scene"), config.get("roi")
    found: dict[str, Any] = {}
    if isinstance(boxes, dict):
        found["antialiased"] = bool(boxes.get("antialiased"))
    if isinstance(scene, dict) and isinstance(boxes, dict):
        steps = scene.get("steps"), boxes.get("steps")
        found["steps"] = sum(steps) if all(isinstance(count, int) for count in steps) else None
    return found


def with_steps(settings: RunSettings) -> RunSettings:
    """The settings of a training to come, with the steps that its preset has now."""
    stages = PRESET_STEPS.get(settings.preset or "")
    factor = settings.steps_factor or 1.0
    steps = sum(max(1, round(count * factor)) for count in stages) if stages else None
    return replace(settings, steps=steps)


def _plain(value: Any) -> Any:
    return value if isinstance(value, (str, int, float)) else None


def read(folder: Path, config: Mapping[str, Any] | None = None) -> RunSettings:
    """The settings of a run folder, or of an archived result; unknown ones are None."""
    try:
        values = files.read_json(folder / run_files.SETTINGS)
    except EngineError:
        values = {}
    return RunSettings.from_options(values if isinstance(values, dict) else {}, config)


def differing(before: RunSettings, now: RunSettings) -> list[str]:
    """Names of the settings that differ, of those that both know; steps if nothing else says so."""
    pairs = {f.name: (getattr(before, f.name), getattr(now, f.name)) for f in fields(RunSettings)}
    names = [name for name, (a, b) in pairs.items() if a != b and None not in (a, b)]
    if "preset" in names or "steps_factor" in names:
        names = [name for name in names if name != "steps"]
    return names


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join((*names[:NAMED], *(["…"] if len(names) > NAMED else [])))


IN_WORDS: dict[str, Callable[[Any], str]] = {
    "preset": lambda value: str(value).capitalize(),
    "max_side": lambda value: f"{value} px",
    "steps_factor": lambda value: f"{value:g} x steps",
    "steps": lambda value: f"{value:,} steps",
    "strategy": lambda value: "boxes together" if value == "joint" else "boxes one by one",
    "antialiased": lambda value: "anti-aliased" if value else "not anti-aliased",
    "method": lambda value: f"method {value}",
    "count": lambda value: (
        f"{text.counted(value, 'photo')} a box" if value else "photos a box: auto"
    ),
    "seed": lambda value: f"seed {value}",
    "test_every": lambda value: f"test photos: 1 in {value}" if value else "no test photos",
    "exclude": lambda value: f"without {_listed(value)}" if value else "all photos",
    "scene": lambda value: f"cameras of {value}",
    "images": lambda value: f"photos of {value}" if value else "the project's photos",
}


def in_words(settings: RunSettings, names: list[str]) -> str:
    """Some of the settings: 'Draft, 640 px'."""
    return ", ".join(IN_WORDS[name](getattr(settings, name)) for name in names)


def title(settings: RunSettings) -> str:
    """A short name of the result of these settings; empty if they are not known."""
    names = [name for name in ("preset", "max_side") if getattr(settings, name) is not None]
    if settings.steps_factor not in (None, 1.0):
        names.append("steps_factor")
    return in_words(settings, names)


def work(settings: RunSettings) -> float | None:
    """The work of a training, in pixels times steps; None if it is not known."""
    steps = settings.steps or with_steps(settings).steps
    if steps is None or settings.max_side is None:
        return None
    return float(steps * settings.max_side**2)
