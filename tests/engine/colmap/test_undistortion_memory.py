"""Undistorting stays within the machine's memory, however large the photos are."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from roigs_engine.colmap import undistort
from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import Context
from roigs_engine.errors import SceneError
from roigs_engine.formats.events import Event, Message
from roigs_engine.machine import ENGINE
from roigs_engine.photos import parallel
from tests.engine.synthetic_colmap import camera, write_project

MB = 10**6


def large(folder: Path, width: int, height: int, count: int = 3) -> Path:
    """A project of photos of that size, all different."""
    lens = camera("SIMPLE_RADIAL", width, height, [width, width / 2, height / 2, 0.05])
    names = [f"{k}.jpg" for k in range(count)]
    write_project(folder, names=names, cameras=[lens], images=None)
    (folder / "images").mkdir()
    for k, name in enumerate(names):
        noise = Image.effect_noise((60, 40), 50 + k).convert("RGB")
        noise.resize((width, height)).save(folder / "images" / name)
    return folder


def machine(monkeypatch: pytest.MonkeyPatch, memory: int) -> None:
    for module in (parallel, undistort):
        monkeypatch.setattr(module, "machine_memory", lambda: memory)
    monkeypatch.setattr(parallel, "usable_cores", lambda: 8)


def test_as_many_threads_as_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    machine(monkeypatch, 2400 * MB)
    needed = [1, 150 * MB, 300 * MB, 500 * MB, 1000 * MB, 5000 * MB]
    assert [parallel.threads_for(size) for size in needed] == [8, 8, 4, 2, 1, 1]


def test_what_is_expected_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    large(tmp_path, 900, 600)
    machine(monkeypatch, ENGINE + 30 * MB)
    events: list[Event] = []
    load_colmap(tmp_path, cache=tmp_path / "cache", context=Context(emit=events.append))
    expected = "Memory: up to about 0.4 GB of 0.4 GB while photos are undistorted, 3 at a time."
    assert Message(text=expected) in events
    events.clear()
    load_colmap(tmp_path, cache=tmp_path / "cache", context=Context(emit=events.append))
    assert not any("Memory" in event.text for event in events if isinstance(event, Message))


def test_what_cannot_fit_is_refused_with_what_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    large(tmp_path, 900, 600, 1)
    machine(monkeypatch, ENGINE + 6 * MB)
    with pytest.raises(SceneError, match=r"0\.5 megapixels needs 0\.4 GB") as raised:
        load_colmap(tmp_path)
    side = int(raised.value.hint.split("--max-side ")[1].split()[0])
    assert 100 < side < 900
    assert len(load_colmap(tmp_path, max_side=side).images) == 1
    machine(monkeypatch, ENGINE + 4 * MB)  # too little to decode it
    with pytest.raises(SceneError) as raised:
        load_colmap(tmp_path, max_side=100)
    assert "smaller photos" in raised.value.hint


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="measures the kernel's count")
@pytest.mark.parametrize("settings", [{}, {"max_side": 3000}, {"max_side": 1000}])
def test_the_kernels_count(tmp_path: Path, settings: dict[str, int]) -> None:
    """One photo of 60 megapixels: no more memory than planned, and not far less at full size."""
    large(tmp_path, 9480, 6320, 1)
    done = subprocess.run(
        [sys.executable, "-c", _MEASURED, tmp_path, str(settings)],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    taken, planned = map(float, done.stdout.split())
    print(f"{taken / 1e6:.0f} MB taken, {planned / 1e6:.0f} MB planned")
    assert taken < 1.05 * planned
    assert settings or taken > 0.8 * planned


_MEASURED = """
import sys
from ast import literal_eval
from pathlib import Path
from benchmarks.memory import resident
from roigs_engine.colmap import undistort
from roigs_engine.colmap.project import load_colmap
before, planned = [], []
memory = undistort._memory
def spy(plans, context):
    planned.append(max(plan.memory() for plan in plans))
    before.append(resident())
    return memory(plans, context)
undistort._memory = spy
load_colmap(sys.argv[1], cache=Path(sys.argv[1], "cache"), **literal_eval(sys.argv[2]))
print((resident("VmHWM") - before[0]) * 2**20, planned[0])
"""
