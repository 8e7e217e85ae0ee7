"""From photos to a COLMAP project: the whole way, stopped and resumed."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from roigs_engine.cli import main
from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import QUIET, Context
from roigs_engine.errors import EngineError, SceneError, Stopped
from roigs_engine.formats.events import Event, Progress, StageStarted
from roigs_engine.photos.mask_paths import MaskOptions
from roigs_engine.reconstruction import worker
from roigs_engine.reconstruction.child import WORKER, run_task
from roigs_engine.reconstruction.database import feature_counts, matched_pairs
from roigs_engine.reconstruction.feature_masks import write_masks
from roigs_engine.reconstruction.folder import Folder
from roigs_engine.reconstruction.photo_checks import Photo, look_at
from roigs_engine.reconstruction.reconstruct import (
    choose_pairs,
    find_features,
    reconstruct,
    threads_in_memory,
)
from roigs_engine.requests.projects import Reconstruct
from tests.engine.commands.command_line import ROOT
from tests.engine.reconstruction.photo_sets import DEMO, copy_photos, demo_photos, write_noise
from tests.machine_load import slowness

pytest.importorskip("pycolmap")

QUICK: dict[str, Any] = {"features": 800, "threads": 2}
SMALL = 0.6  # of the demo's photos, which is much less work
NAMES = [f"# wide/übung {number}.jpg" for number in range(6)]


def make(photos: Path, out: Path, context: Context = QUIET, **options: Any) -> None:
    """Reconstruct photos with few features."""
    request = Reconstruct(photos=photos, out=out, **(QUICK | options))
    reconstruct(request, MaskOptions(), context)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A reconstruction of six photos with awkward names, and one that fits nowhere."""
    folder = tmp_path_factory.mktemp("reconstruction")
    copy_photos(folder / "photos", demo_photos("wide/*.jpg", 6), NAMES, SMALL)
    write_noise(folder / "photos/noise.png")
    make(folder / "photos", folder / "scene")
    return folder / "scene"


def test_the_result_is_a_colmap_project(scene: Path) -> None:
    loaded = load_colmap(scene, pixels=False)
    assert [image.name for image in loaded.images] == NAMES
    assert loaded.has_tracks and len(loaded.points) > 100
    assert len({image.camera for image in loaded.images}) == 1


def test_the_report_says_what_was_not_registered_and_why(scene: Path) -> None:
    text = (scene / "reconstruction.md").read_text("utf-8")
    assert "| photos registered | 6 of 7 |" in text
    assert "| noise.png | small; " in text


def test_the_same_command_again_does_nothing(
    scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (scene / "sparse/0/images.bin").stat().st_mtime_ns
    photos = scene.parent / "photos"
    assert main(["reconstruct", str(photos), "--out", str(scene), "--features", "800"]) == 0
    assert (scene / "sparse/0/images.bin").stat().st_mtime_ns == before
    assert "up to date" in capsys.readouterr().err


class Stopping:
    """Asks for a stop once so many steps of a stage are done."""

    def __init__(self, stage: str, steps: int) -> None:
        self.stage, self.steps, self.at = stage, steps, float("inf")

    def emit(self, event: Event) -> None:
        if not isinstance(event, StageStarted | Progress) or event.stage != self.stage:
            return
        if (event.step if isinstance(event, Progress) else 0) >= self.steps:
            self.at = min(self.at, time.monotonic())

    def asked(self) -> bool:
        return time.monotonic() >= self.at

    @property
    def context(self) -> Context:
        return Context(emit=self.emit, should_stop=self.asked)


@pytest.fixture(scope="module")
def resumed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A reconstruction of four photos that was stopped in each stage."""
    folder = tmp_path_factory.mktemp("resumed")
    copy_photos(folder / "photos", demo_photos("wide/*.jpg", 4), NAMES[:4], SMALL)
    out, features = folder / "scene", 0
    stages = {"look at photos": 0, "features": 1, "matching": 0, "mapping": 0}
    for stage, steps in stages.items():
        stopping = Stopping(stage, steps)
        with pytest.raises(Stopped):
            make(folder / "photos", out, stopping.context, threads=1)
        assert time.monotonic() - stopping.at < 2 * slowness()
        if (out / "database.db").exists():
            found = len(feature_counts(out / "database.db"))
            assert found >= features
            features = found
    assert features == 4
    return folder


def test_it_resumes_where_it_was_stopped_and_takes_new_photos(resumed: Path) -> None:
    photos, out, started = resumed / "photos", resumed / "scene", list[str]()

    def emit(event: Event) -> None:
        if isinstance(event, StageStarted):
            started.append(event.stage)

    make(photos, out, Context(emit=emit))
    assert started == ["look at photos", "mapping"]
    assert len(load_colmap(out, pixels=False).images) == 4
    first, places = matched_pairs(out / "database.db"), centres(out)
    copy_photos(photos, demo_photos("wide/*.jpg", 5)[4:], NAMES[4:5], SMALL)
    make(photos, out)
    extent = np.linalg.norm(np.ptp([*places.values()], axis=0))
    for name, place in centres(out).items():  # boxes and results stay where they belong
        assert name not in places or np.linalg.norm(place - places[name]) < 1e-6 * extent
    assert first.items() <= matched_pairs(out / "database.db").items()
    with closing(sqlite3.connect(out / "database.db")) as file:
        assert file.execute("SELECT COUNT(DISTINCT camera_id) FROM images").fetchone() == (1,)
    assert len(load_colmap(out, pixels=False).images) == 5
    assert (out / "reconstruction/earlier/0/images.bin").exists()


def centres(project: Path) -> dict[str, np.ndarray]:
    return {image.name: image.centre for image in load_colmap(project, pixels=False).images}


def test_photos_that_match_nothing_are_one_line_and_a_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(2):
        write_noise(tmp_path / f"photos/{number}.png", number)
    arguments = ("--out", tmp_path / "scene", "--features", 300)
    assert main([str(word) for word in ("reconstruct", tmp_path / "photos", *arguments)]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("error: ")
    assert "No two photos could be registered" in line
    assert "no photo matches it" in (tmp_path / "scene/reconstruction.md").read_text("utf-8")


def test_features_are_not_found_where_a_mask_is_black(tmp_path: Path) -> None:
    names = ["a.jpg", "b.jpg"]
    folder = Folder(tmp_path / "scene")
    copy_photos(folder.images, demo_photos("wide/*.jpg", 2), names, 0.5)
    mask = np.zeros((214, 320), dtype=np.uint8)
    mask[:, 160:] = 255
    (tmp_path / "masks").mkdir()
    Image.fromarray(mask).save(tmp_path / "masks/b.jpg.png")
    folder.work().mkdir()
    found = look_at(folder.photos_of(folder.images), folder.work("photos.json"), QUIET)
    options = MaskOptions(folder=tmp_path / "masks")
    masks = write_masks(found.photos, folder.images, options, folder, QUIET)
    request = Reconstruct(photos=folder.images, out=folder.root, features=800, threads=1)
    find_features(folder, replace(found, masks=masks), request, QUIET)
    with closing(sqlite3.connect(folder.database)) as file:
        query = "SELECT name, cols, data, camera_id FROM images JOIN keypoints USING (image_id)"
        rows = {name: rest for name, *rest in file.execute(query)}
    left = {
        name: np.frombuffer(data, dtype=np.float32).reshape(-1, columns)[:, 0].min()
        for name, (columns, data, _) in rows.items()
    }
    assert left["a.jpg"] < 50 and left["b.jpg"] >= 160
    assert len({camera for _, _, camera in rows.values()}) == 1


def test_threads_fit_into_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    photo = Photo(name="a", path=Path("a"), digest="", size=(6000, 4000), device="", sharpness=1.0)
    for gigabytes, threads in ((64, 16), (4, 2), (1, 1)):
        memory = gigabytes << 30
        monkeypatch.setattr(
            "roigs_engine.reconstruction.reconstruct.machine_memory", lambda m=memory: m
        )
        assert threads_in_memory([photo], 1600, 16) == threads


@pytest.mark.parametrize(("kind", "least"), [("all", 21), ("similar", 12), ("ordered", 12)])
def test_pairs_are_chosen(scene: Path, kind: str, least: int) -> None:
    request = Reconstruct(photos=scene, out=scene, pairs=kind, neighbours=2)
    names = sorted(feature_counts(scene / "database.db"))
    found = choose_pairs(Folder(scene), names, request, QUIET)
    assert least <= len(found) <= 21
    assert all((names[k], names[k + 1]) in found for k in range(len(names) - 1))


@pytest.mark.slow
def test_the_demo_is_registered(tmp_path: Path) -> None:
    make(DEMO, tmp_path / "scene", features=0, threads=None)
    model = load_colmap(tmp_path / "scene", pixels=False)
    assert len(model.images) >= 89
    heights = np.sort(model.points[:, 2])
    assert abs(heights[len(heights) // 50]) < 0.05  # the floor


def test_pycolmap_that_dies_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    missing = [sys.executable, "-m", "this"]
    monkeypatch.setattr("roigs_engine.reconstruction.child.WORKER", missing)
    with pytest.raises(SceneError, match="ended without a result"):
        run_task({}, tmp_path / "log.txt", QUIET)
    monkeypatch.setattr("roigs_engine.reconstruction.child.FULL", 1 << 60)
    with pytest.raises(SceneError, match=r"The disk of .* is full"):
        run_task({}, tmp_path / "log.txt", QUIET)


def test_a_damaged_database_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "database.db").write_bytes(b"this is no database" * 100)
    task = {"work": "map", "database": str(tmp_path / "database.db")}
    with pytest.raises(EngineError, match=r"Cannot use .*database\.db \(file is not a database\)"):
        run_task(task, tmp_path / "log.txt", QUIET)


def test_the_worker_ends_with_its_parent() -> None:
    with subprocess.Popen(WORKER, cwd=ROOT, stdin=subprocess.PIPE) as process:
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(30) is not None


def test_an_old_pycolmap_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    class Old:
        __version__ = "3.12.0"

    monkeypatch.setattr(worker, "pycolmap_module", lambda purpose: Old())
    with pytest.raises(Exception, match=r"needs pycolmap 4\.2; this is 3\.12\.0"):
        worker.colmap_module()
