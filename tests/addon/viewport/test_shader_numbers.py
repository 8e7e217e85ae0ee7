"""The viewport's shader and the engine have the same model: its numbers are written in both."""

from __future__ import annotations

import re

import pytest

from tests.addon.scenes import ROOT

SHADER = ROOT / "roigs_addon" / "viewport" / "shaders" / "splat.vert.glsl"


NAMES = ["ALPHA_MIN", "BLUR", "FRUSTUM_MARGIN", "MAX_SLOPE", "MIN_SIGMAS"]


@pytest.mark.parametrize("name", NAMES)
def test_it_is_the_engines_number(name: str) -> None:
    pytest.importorskip("torch")
    from roigs_engine.rasterize import inputs, limits

    text = SHADER.read_text(encoding="utf-8")
    found = re.search(rf"^#define {name} \(?([\d.]+)(?: / ([\d.]+)\))?\s", text, re.MULTILINE)
    assert found is not None
    assert float(found[1]) / float(found[2] or 1) == vars(inputs).get(name, vars(limits).get(name))
