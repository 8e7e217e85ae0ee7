"""The large demo capture: its photos' EXIF, development and faults; nothing is rendered."""

from __future__ import annotations

import sys
from argparse import Namespace
from dataclasses import replace
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


def test_without_drift_all_photos_have_the_median_exposure(
    capture: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shots = capture.large_shots
    place = shots.Taken("a.jpg", shots.Vector((1, 0, 1)), shots.Vector((0, 0, 1)))
    stops = {"a.jpg": -1.0, "b.jpg": 0.25, "c.jpg": 1.25, "held_out/d.jpg": 0.0}
    taken = [replace(place, name=name, stops=value) for name, value in stops.items()]
    for name in stops:
        path = (tmp_path / "linear" / name).with_suffix(".exr")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    monkeypatch.setattr(capture, "sensor", lambda path: np.full((8, 8, 3), 0.2))
    for drift, photos in ((1.0, "images"), (0.0, "even")):
        capture.develop(Namespace(out=tmp_path, drift=drift, photos=photos), taken)
    values = [np.asarray(Image.open(path)) for path in sorted((tmp_path / "even").iterdir())]
    held_out = [
        np.asarray(Image.open(tmp_path / f"{n}_held_out" / "d.png")) for n in ("images", "even")
    ]
    assert (held_out[0] == held_out[1]).all()
    assert all(np.abs(v.astype(int) - held_out[0]).max() <= 2 for v in values)
    exposures = {n: exif_exposure(tmp_path / n / "a.jpg") for n in ("images", "even")}
    assert exposures["even"] - exposures["images"] == pytest.approx(1.25, abs=1e-3)


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
