"""Memory is bounded whatever a model lists, and what a run needs is said before it begins."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roigs_engine.errors import SceneError
from roigs_engine.model.scene import PosedImage
from roigs_engine.photos import cache as photo_cache
from roigs_engine.photos.cache import PhotoCache
from roigs_engine.run import memory
from roigs_engine.run.memory import plan_memory
from roigs_engine.run.presets import preset
from roigs_engine.training.photo_order import shuffled
from tests.engine.run.large_photos import CAMERA, GB, ONE, posed
from tests.engine.synthetic_colmap import camera, write_project


def test_2000_photos_of_24_megapixels_stay_in_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two epochs as training asks for them, with photos whose memory is only counted."""
    lock, alive, most = threading.Lock(), 0, 0

    def count(change: int) -> None:
        nonlocal alive, most
        with lock:
            alive += change
            most = max(most, alive)

    def load(image: PosedImage) -> np.ndarray:
        pixels = np.empty((image.camera.height, image.camera.width, 3), np.uint8)
        count(pixels.nbytes)
        weakref.finalize(pixels, count, -pixels.nbytes)
        return pixels

    monkeypatch.setattr(photo_cache, "load_masked", load)
    photo_at = shuffled(range(2000), 0)
    with PhotoCache(posed(2000), limit_bytes=GB) as cache:
        for step in range(4000):
            cache.prefetch([photo_at(step + ahead) for ahead in (1, 2)])
            assert cache[photo_at(step)].nbytes == ONE
            assert cache.kept_bytes <= GB
    # One in use, two under way, beside those that are kept.
    assert ONE < most <= GB + 3 * ONE


def test_what_is_expected_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "machine_memory", lambda: 16 * GB)
    plan = plan_memory(posed(2000), 100_000, preset("draft"))
    assert plan.photos == 2000 * ONE and plan.cache == 4 * GB
    assert plan.count > 100_000 and plan.total < 16 * GB
    first, second = plan.messages()
    assert "of 16.0 GB" in first.text and f"{plan.count:,} Gaussians" in first.text
    assert "144.0 GB" in second.text and "4.0 GB are kept" in second.text
    (small,) = plan_memory(posed(3), 1000, preset("draft")).messages()
    assert "photos 0.2 GB" in small.text
    assert plan_memory(posed(2000), 1000, preset("draft"), cache=GB).cache == GB
    assert plan_memory(posed(2000), 1000, preset("draft"), cache=0).cache == 3 * ONE


def test_what_may_not_fit_is_warned_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "machine_memory", lambda: 4 * GB)
    warning = plan_memory(posed(9), 1000, preset("paper")).messages()[-1]
    assert warning.level == "warning" and "--max-side" in warning.text


def test_what_cannot_fit_is_refused_with_what_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "machine_memory", lambda: 2 * GB)
    with pytest.raises(SceneError, match=r"24\.0 megapixels.*2\.0 GB.*--max-side (\d+)") as raised:
        plan_memory(posed(9), 100_000, preset("draft"))
    side = int(str(raised.value).split("--max-side ")[1].split()[0])
    assert 1000 < side < 6000
    fitting = replace(CAMERA, width=side, height=side * 2 // 3)
    plan_memory(posed(9, fitting), 100_000, preset("draft"))
    with pytest.raises(SceneError, match="fewer points"):
        plan_memory(posed(9), 100_000_000, preset("draft"))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="measures the kernel's count")
def test_training_on_2000_large_photos(tmp_path: Path) -> None:
    """The whole engine, its photos one JPEG under 2,000 names: the kernel's count of memory."""
    lens = camera(width=6000, height=4000, params=[5000.0, 5000.0, 3000.0, 2000.0])
    names = [f"{k:04d}.jpg" for k in range(2000)]
    write_project(tmp_path, names=names, cameras=[lens], images=None)
    (tmp_path / "images").mkdir()
    noise = np.random.default_rng(0).integers(0, 256, (40, 60, 3), dtype=np.uint8)
    Image.fromarray(noise).resize((6000, 4000)).save(tmp_path / "images" / names[0])
    for name in names[1:]:
        os.link(tmp_path / "images" / names[0], tmp_path / "images" / name)
    command = [sys.executable, "-c", _MEASURED, "train", tmp_path, "--test-every", "0"]
    command += ["--roi", "thing=-0.5,-0.5,-0.5,0.5,0.5,0.5", "--run-dir", tmp_path / "run"]
    command += ["--steps-factor", "0.01", "--count", "5", "--image-cache", "500"]
    done = subprocess.run([*map(str, command)], stdout=subprocess.PIPE, text=True, check=True)
    peak = float(done.stdout.splitlines()[-1]) * 2**20
    allowed = memory.ENGINE + 500e6 + 3 * ONE + memory.PER_PIXEL_AT_MOST * ONE / 3
    print(f"{peak / 2**20:.0f} MiB at most, {allowed / 2**20:.0f} were planned for")
    assert 500e6 < peak < allowed


# In the engine's own process: what the system tells its parent counts the parent's memory, too.
_MEASURED = """
import sys
from benchmarks.memory import resident
from roigs_engine import cli
status = cli.main(sys.argv[1:])
print(resident("VmHWM"))
sys.exit(status)
"""
