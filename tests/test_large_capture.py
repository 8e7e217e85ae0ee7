"""The large demo capture: its photos' EXIF, development and faults; nothing is rendered."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from roigs_engine.photos.exposures import exif_exposure

pytest.importorskip("bpy")
DEMO = Path(__file__).resolve().parents[1] / "demo"


@pytest.fixture(scope="module")
def capture() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DEMO))
        yield import_module("large_capture")
    for name in [name for name, module in sys.modules.items() if _is_of_demo(module)]:
        del sys.modules[name]


def _is_of_demo(module: Any) -> bool:
    return str(getattr(module, "__file__", None) or "").startswith(str(DEMO))


def test_exif_tells_the_exposure(capture: Any, tmp_path: Path) -> None:
    known = []
    stops = (-1.5, -0.3, 0.0, 0.7, 1.2)
    for number, exposure in enumerate(stops):
        path = tmp_path / f"{number}.jpg"
        Image.new("RGB", (8, 8)).save(path, exif=capture.exif(exposure))
        known.append(exif_exposure(path))
    assert np.diff(known) == pytest.approx(np.diff(stops), abs=1e-3)


def test_development_doubles_light_by_a_stop_and_clips(capture: Any) -> None:
    light = np.array([[[0.0, 0.1, 0.4], [0.2, 0.8, 7.0]]])
    plain, brighter = (np.asarray(capture.developed(light, stops)) for stops in (0.0, 1.0))
    doubled = np.asarray(capture.developed(2 * light, 0.0))
    assert (brighter == doubled).all()
    assert brighter.max() == 255 and plain[0, 0].tolist() == [0, 89, 170]


def test_exposure_drifts_within_its_range(capture: Any) -> None:
    rng = np.random.default_rng(0)
    stops = capture.large_shots._drift(rng, 2000)
    assert 1.2 < stops.max() <= 1.5 and -1.5 <= stops.min() < -1.2
    assert np.abs(np.diff(stops)).max() < 1.0


def test_faults_are_of_their_own_photos(capture: Any) -> None:
    shots, rng = capture.large_shots, np.random.default_rng(0)
    place = shots.Taken("a.jpg", shots.Vector((1, 0, 1)), shots.Vector((0, 0, 1)))
    taken = [shots._spoilt(place, rng, number) for number in range(120)]
    blurred = [shot for shot in taken if any((*shot.slide, *shot.swing))]
    focused = [shot for shot in taken if shot.focus is not None]
    assert len(blurred) == 12 and len(focused) == 8 and all(s.focus < 0.6 for s in focused)
    assert sum(shot.plain for shot in taken) == 120 - 12 - 8
    still, moving = blurred[0].moved(0.0), blurred[0].moved(0.5)
    assert still == blurred[0].matrix() and still != moving
