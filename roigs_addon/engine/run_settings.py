"""Compares the settings of two trainings, and describes them in words. No bpy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from ..shared import EngineError, files, run_files, targets, text
from .training_steps import MOST_FACTOR, PRESET_STEPS, stage_steps

THIS, EARLIER = "this version's settings", "an earlier version's settings"
LATER = ("exclude", "count", "steps", "recipe")
"""Settings that need special treatment."""
MOST_STEPS = 10**9
MADE_FOR = {target.name: target.title for target in targets.TARGETS.values()}
TEXTS = ("preset", "strategy", "made_for", "method", "scene", "images")
LONGEST = 1000
"""Longest text kept, in letters."""
NAMED = 2
"""Number of photos that are named."""
BOX_SETTINGS = ("method", "count")
"""Settings that decide only the boxes' photos."""


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """Settings that decide a result, except boxes and photo lists. None means unknown.

    Attributes:
        preset, strategy, method, count, seed, test_every: as the engine's options.
        max_side, steps_factor, made_for: as the engine's options.
        steps: sum of the scene's and the boxes' steps; not compared.
        recipe: whether the preset's settings are those of this version.
        exclude: names of the excluded photos.
        scene, images: names of the folders. Their paths change when a project is moved.
    """

    preset: str | None = None
    max_side: int | None = None
    steps_factor: float | None = None
    steps: int | None = None
    recipe: str | None = None
    strategy: str | None = None
    made_for: str | None = None
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
        """Return the settings of an options file.

        Args:
            values: of the file.
            config: of the manifest, for settings that the file leaves to the preset.
        """
        config = config or {}
        selection = config.get("selection")
        chosen = selection if isinstance(selection, dict) else {}
        known = {**chosen, **_of_stages(config), **config, **values}
        names = [field.name for field in fields(cls) if field.name not in LATER]
        found = {name: _plain(name, known.get(name)) for name in names}
        if values:
            found["steps_factor"] = found["steps_factor"] or 1.0
            found["images"] = found["images"] or ""
        found |= {key: Path(found[key]).name for key in ("scene", "images") if found[key]}
        exclude, count = values.get("exclude"), _plain("count", known.get("count"))
        listed = exclude if isinstance(exclude, list) else []
        return cls(
            **found,
            exclude=tuple(sorted(map(str, listed))) if values else None,
            count=(count or 0) if known else None,
        )._with_recipe(config)

    def _with_recipe(self, config: Mapping[str, Any]) -> RunSettings:
        """Add the manifest's steps, and whether they are those of this version."""
        scene, boxes = config.get("scene"), config.get("roi")
        if not isinstance(scene, dict) or not isinstance(boxes, dict):
            return self
        stages = _count(scene.get("steps")), _count(boxes.get("steps"))
        usual = self.of_this_version().steps
        if None in stages or usual is None:
            return self
        steps = sum(count or 0 for count in stages)
        return replace(self, steps=steps, recipe=THIS if steps == usual else EARLIER)

    def of_this_version(self) -> RunSettings:
        """Return the settings of a new training, with this version's preset."""
        name, factor, steps = str(self.preset), self.steps_factor or 1.0, None
        if name in PRESET_STEPS and not isinstance(factor, str) and 0 < factor < MOST_FACTOR:
            steps = sum(stage_steps(name, factor))
        return replace(self, steps=steps, recipe=THIS)


def _of_stages(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the manifest's settings of the stages."""
    stage = config.get("roi")
    return {"made_for": stage.get("made_for")} if isinstance(stage, dict) else {}


def _count(value: Any) -> int | None:
    """Return a valid number of steps, else None."""
    good = isinstance(value, int) and not isinstance(value, bool) and 0 < value < MOST_STEPS
    return value if good else None


def _plain(name: str, value: Any) -> Any:
    """Return the value of a setting; None if it is invalid: the file is untrusted."""
    if name in TEXTS:
        return text.printable(value)[:LONGEST] if isinstance(value, str) else None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    if name == "steps_factor":
        return value if 0 < value < MOST_FACTOR else None
    return value if isinstance(value, int) and abs(value) < MOST_STEPS else None


def read(folder: Path, config: Mapping[str, Any] | None = None) -> RunSettings:
    """Read the settings of a run folder, or of an earlier result; unknown ones are None."""
    try:
        values = files.read_json(folder / run_files.SETTINGS)
    except EngineError:
        values = {}
    return RunSettings.from_options(values if isinstance(values, dict) else {}, config)


def differing(before: RunSettings, now: RunSettings) -> list[str]:
    """Return the names of known settings that differ; `recipe` only if no other differs."""
    pairs = {name: (getattr(before, name), getattr(now, name)) for name in IN_WORDS}
    names = [name for name, (a, b) in pairs.items() if a != b and None not in (a, b)]
    return [name for name in names if name != "recipe"] or names


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join((*names[:NAMED], *(["…"] if len(names) > NAMED else [])))


IN_WORDS: dict[str, Callable[[Any], str]] = {
    "preset": lambda value: str(value).capitalize(),
    "max_side": lambda value: f"{value} px",
    "steps_factor": lambda value: f"{value:g} x steps",
    "recipe": str,
    "strategy": lambda value: "boxes together" if value == "joint" else "boxes one by one",
    "made_for": lambda value: f"made for {MADE_FOR.get(value, value)}",
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
    """Describe some of the settings: 'Draft, 640 px'."""
    return ", ".join(IN_WORDS[name](getattr(settings, name)) for name in names)


def title(settings: RunSettings) -> str:
    """Return a short name for the result of these settings; empty if they are unknown."""
    names = [name for name in ("preset", "max_side") if getattr(settings, name) is not None]
    if settings.steps_factor not in (None, 1.0):
        names.append("steps_factor")
    if settings.made_for not in (None, targets.VIEWERS.name):
        names.append("made_for")
    return in_words(settings, names)


def work(settings: RunSettings) -> float | None:
    """Return the work of a training, in pixels times steps; None if unknown."""
    steps = settings.steps or settings.of_this_version().steps
    if steps is None or settings.max_side is None:
        return None
    return float(steps * settings.max_side**2)
