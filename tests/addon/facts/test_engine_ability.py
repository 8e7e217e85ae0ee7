"""The engine's abilities in the panel."""

from __future__ import annotations

import functools
from types import ModuleType

import pytest

pytestmark = pytest.mark.blender


def test_an_engine_that_lacked_something_is_asked_again(
    blender: ModuleType, addon: ModuleType, monkeypatch
) -> None:
    from roigs_addon.engine import python
    from roigs_addon.facts import engine_ability

    missing = [("torch",), ()]
    fresh = functools.lru_cache(lambda _: python.Ability(version=(3, 12), missing=missing.pop(0)))
    monkeypatch.setattr(python, "ability", fresh)
    monkeypatch.setattr(engine_ability, "RECHECK_SECONDS", 0.0)
    engine = engine_ability.EngineCheck()
    for expected in ("torch", ""):
        engine.ask()
        engine.thread.join()
        assert expected in engine.problem and bool(expected) == bool(engine.problem)
