"""The study: what it measures, that it goes on where it was, and what its tables say."""

from __future__ import annotations

import json
import shutil
import signal
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from benchmarks.study import __main__ as command
from benchmarks.study import figures, measure, work
from benchmarks.study.measure import Bench
from benchmarks.study.results import Results, load_records
from benchmarks.study.scenes import StudyScene, parse_scenes
from roigs_engine.cli import STOPPED
from roigs_engine.colmap.project import load_colmap
from roigs_engine.commands.stopping import SIGNALS
from roigs_engine.errors import ConfigError, SceneError, Stopped
from roigs_engine.kernels import library
from roigs_engine.run import presets
from roigs_engine.run.config import RunConfig
from roigs_engine.run.presets import preset
from roigs_engine.training import floaters
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.mechanisms.model_averaging import ModelAveraging
from tests.engine.colmap.drifting import STOPS, project
from tests.engine.settings import adjusted, without
from tests.engine.synthetic_scene import make_scene

ROIS = {
    "rois": [
        {"name": "thing", "min": [-0.6, -0.6, -0.6], "max": [0.6, 0.6, 0.6]},
        {"name": "part", "min": [-0.1, -0.6, -0.6], "max": [0.6, 0.6, 0.6]},
    ]
}
ROWS = ["full-scene", "matched", "joint"]
VARIANT = "roomy:roi.box_density_control.budget=90,selected_share=0.5"
SEEDS = (0, 1)


def tiny() -> RunConfig:
    """Twenty steps a stage; the boxes densify readily, the scene not at all."""
    draft = preset("draft")
    density = DensityControl(start=2, every=2, until=15, reset_every=0, grad_threshold=9.0)
    scene = TrainConfig(steps=20, made_for="viewers", mechanisms=(density,))
    quick = {"every": 2, "until": 15, "grad_threshold": 1e-9, "budget": 3.0}
    roi = without(adjusted(draft.roi, DensityControl, **quick), ModelAveraging)
    return replace(draft, scene=scene, roi=replace(roi, steps=20), test_every=4)


@pytest.fixture(scope="module", autouse=True)
def small_world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A scene without COLMAP files, a preset of a few steps, and Ctrl-C as it was before."""
    scene = make_scene(tmp_path_factory.mktemp("photos"), views=10)
    before = [signal.getsignal(number) for number in SIGNALS]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(work, "load_colmap", lambda *args, **options: scene)
        patch.setitem(presets.PRESETS, "tiny", tiny)
        patch.setattr(floaters, "MOST_VIEWS", 6)  # else the search takes longer than the steps
        patch.setattr(DensityControl, "grad_threshold", 9.0)  # the baselines' own would densify it
        yield
    library.set_threads(None)
    for number, handler in zip(SIGNALS, before, strict=True):
        signal.signal(number, handler)


@pytest.fixture(scope="module")
def scene_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes") / "ball"
    folder.mkdir()
    (folder / "rois.json").write_text(json.dumps(ROIS), encoding="utf-8")
    return folder


def study(scene: Path, out: Path, *options: str) -> int:
    arguments = [str(scene), "--out", str(out), "--preset", "tiny", "--threads", "1", *options]
    return command.main(arguments)


@pytest.fixture(scope="module")
def done(scene_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of the main rows and a variant, in two seeds."""
    out = tmp_path_factory.mktemp("study")
    assert study(scene_folder, out, "--rows", *ROWS, "--seeds", "0", "1") == 0
    assert study(scene_folder, out, "--rows", "joint", "--vary", VARIANT, "--seeds", "0") == 0
    return out


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The rows that are measured from now on."""
    rows: list[str] = []
    original = Bench.measure

    def measure(self, row, **options):  # type: ignore[no-untyped-def]
        rows.append(f"{row.name} {self.seed}")
        return original(self, row, **options)

    monkeypatch.setattr(Bench, "measure", measure)
    return rows


def test_photos_are_levelled_as_in_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project(tmp_path, STOPS, STOPS)
    monkeypatch.setattr(work, "load_colmap", load_colmap)
    made = work.Work(
        folder=tmp_path / "study",
        preset="draft",
        factor=1.0,
        max_side=None,
        evaluate_on="test",
        keep_models=False,
    )
    found = made._sfm(StudyScene(name="room", path=tmp_path, rois=[]))
    exposures = [image.exposure for image in found.images]
    assert exposures == pytest.approx(STOPS - np.median(STOPS), abs=0.01)


def test_every_row_is_measured_on_the_same_pixels(done: Path) -> None:
    records = load_records(done / "rows")
    assert {(r["row"], r["seed"]) for r in records} == {
        *((row, seed) for row in ROWS for seed in SEEDS),
        ("roomy", 0),
    }
    split = json.loads((done / "runs" / "ball" / "seed-0" / "split.json").read_text("utf-8"))
    for seed in SEEDS:
        evaluations = [r["evaluation"] for r in records if r["seed"] == seed]
        for evaluation in evaluations:
            assert evaluation["test_views"] == split["test"]
            for roi, first in zip(evaluation["rois"], evaluations[0]["rois"], strict=True):
                assert roi["object_mask_from"] == "Full Scene"
                assert roi["views"] == first["views"] != []
                assert roi["rows"][0]["roi_psnr"] == first["rows"][0]["roi_psnr"]


def test_the_matched_baseline_has_our_number_of_gaussians(done: Path) -> None:
    results = Results(load_records(done / "rows"))
    for box in ("thing", "part"):
        full, matched, ours = (
            results.stat("ball", box, row, model, "in_box").values
            for row, model in (
                ("full-scene", "Full Scene"),
                ("matched", "Matched"),
                ("joint", "Joint"),
            )
        )
        for seed in SEEDS:
            room = ours[seed] - full[seed]
            assert room > 100
            # Its limit rises evenly, so at the last of few densifying steps it is not yet all.
            assert 0.8 * room < matched[seed] - full[seed] < 1.05 * room


def test_times_are_the_sums_of_stages(done: Path) -> None:
    results = Results(load_records(done / "rows"))
    entry = results.entries("ball", "thing", "joint", "Joint")[0]
    stages = entry.record["stages"]
    for clock in ("seconds", "cpu_seconds"):
        assert stages["scene"][clock] > 0
        assert entry.spent(clock) == stages["scene"][clock] + stages["joint"][clock]
    ratio = results.stat("ball", "thing", "joint", "Joint", "cpu_ratio").values[0]
    assert ratio == pytest.approx(entry.spent("cpu_seconds") / stages["full-scene"]["cpu_seconds"])


def test_what_is_done_is_not_measured_again(
    done: Path, scene_folder: Path, measured: list[str]
) -> None:
    before = {path: path.read_bytes() for path in (done / "rows").rglob("*.json")}
    assert study(scene_folder, done, "--rows", *ROWS, "--seeds", "0", "1") == 0
    assert measured == []
    assert {path: path.read_bytes() for path in (done / "rows").rglob("*.json")} == before


def test_a_record_of_another_manifest_is_kept_and_measured_again(
    done: Path,
    scene_folder: Path,
    tmp_path: Path,
    measured: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Also one that an earlier version wrote, which has no manifest."""
    out = tmp_path / "study"
    shutil.copytree(done, out)
    path = out / "rows" / "ball" / "seed-0" / "joint.json"
    record = json.loads(path.read_text(encoding="utf-8"))
    record["request"] = record.pop("manifest")
    path.write_text(json.dumps(record), encoding="utf-8")
    assert study(scene_folder, out, "--rows", *ROWS, "--seeds", "0", "1") == 0
    assert measured == ["joint 0"]
    assert "settings, photos or boxes have changed" in capsys.readouterr().err
    (earlier,) = (path.parent / "earlier").iterdir()
    assert json.loads(earlier.read_text(encoding="utf-8")) == record
    assert len(load_records(out / "rows")) == len(load_records(done / "rows"))


def test_ablations_start_from_the_scene_of_the_unchanged_settings(
    scene_folder: Path, tmp_path: Path
) -> None:
    options = ("--rows", "full-scene", "independent", "gp6-20", "--keep-models", "--seeds", "0")
    assert study(scene_folder, tmp_path, *options) == 0
    folder = tmp_path / "runs" / "ball" / "seed-0"
    assert (
        json.loads((folder / "manifest.json").read_text("utf-8"))["config"]["selection"]["method"]
        == "gp6"
    )
    first, second = (
        next(r for r in load_records(tmp_path / "rows") if r["row"] == row)
        for row in ("independent", "gp6-20")
    )
    assert first["stages"]["scene"] == second["stages"]["scene"]
    stages = [path.name.rpartition("-")[0] for path in (folder / "stages").iterdir()]
    assert sorted(stages) == [*["full-scene"], *2 * ["object-part"], *2 * ["object-thing"], "scene"]


def test_the_page_shows_missing_rows_and_single_seeds(done: Path, scene_folder: Path) -> None:
    assert study(scene_folder, done, "--report-only", "--tables", "I", "II", "III") == 0
    page = (done / "study.md").read_text(encoding="utf-8")
    lines = {line.split("|")[1].strip(): line for line in page.splitlines() if "|" in line}
    full_object = [cell.strip() for cell in lines["Full Object"].split("|")[2:-1]]
    assert set(full_object[:-1]) == {"-"} and full_object[-1] == "0"
    assert "±" in lines["Joint"] and "†" not in lines["Joint"].split("|")[2]
    assert "†" in lines["roomy"] and "±" not in lines["roomy"]
    assert "roi.box_density_control.budget=90.0,selected_share=0.5" in page
    assert page.count("Near and far, and single photos") == 3  # two boxes, and all of them
    assert (
        ("| FLIP |" in page) == ("FLIP change" in page) == (find_spec("flip_evaluator") is not None)
    )
    for text in ("Table I:", "Table II:", "Table III:", "Beyond", "torch 2", "tiny", "20 + 20"):
        assert text in page
    record = json.loads((done / "study.json").read_text(encoding="utf-8"))
    line = next(x for x in record["lines"] if (x["box"], x["model"]) == ("part", "Joint"))
    gain = line["metrics"]["gain"]
    assert gain["n"] == 2 and set(gain["seeds"]) == {"0", "1"}
    assert gain["mean"] == pytest.approx(sum(gain["seeds"].values()) / 2)
    by_view = line["gains"]["0"].values()
    assert gain["seeds"]["0"] == pytest.approx(sum(by_view) / len(by_view))


def test_crops_of_results_are_there_and_figures_if_they_can_be(
    done: Path, capsys: pytest.CaptureFixture[str], scene_folder: Path
) -> None:
    (record,) = (r for r in load_records(done / "rows") if (r["row"], r["seed"]) == ("joint", 0))
    for pictures in record["pictures"].values():
        assert {"largest gain", "least gain"} <= set(pictures)
        for path in pictures.values():
            assert (done / "pictures" / "ball" / "seed-0" / path).is_file()
    study(scene_folder, done, "--report-only")
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        assert "matplotlib is missing" in capsys.readouterr().err
    else:
        drawn = {path.name for path in (done / "figures").iterdir()}
        assert drawn == {"gain.png", "distance.png", "crops-ball.png"}
        assert (done / "study.pdf").stat().st_size > 1000


def test_no_figures_without_matplotlib(
    done: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    said: list[str] = []
    results = Results(load_records(done / "rows"))
    drawn = figures.write_figures(results, [], "joint", tmp_path, lambda e: said.append(e.text))
    assert drawn == {} and len(said) == 1 and "study" in said[0]


def test_a_study_cut_short_goes_on(
    scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, measured: list[str]
) -> None:
    options = ("--rows", "full-scene", "joint-20", "box-20", "--seeds", "3")
    original = Bench.measure

    def stopped(self, row, **rest):  # type: ignore[no-untyped-def]
        if row.name == "joint-20":
            raise Stopped
        if row.name == "box-20":
            raise SceneError("No light.")
        return original(self, row, **rest)

    with monkeypatch.context() as patch:
        patch.setattr(Bench, "measure", stopped)
        assert study(scene_folder, tmp_path, *options) == STOPPED
    assert measured == ["full-scene 3"]
    assert "Full Scene" in (tmp_path / "study.md").read_text(encoding="utf-8")
    assert study(scene_folder, tmp_path, *options) == 0
    assert measured == ["full-scene 3", "box-20 3", "joint-20 3"]
    runs = tmp_path / "runs" / "ball" / "seed-3"
    # The stages of both ablations are gone, those that rows share have stayed.
    left = {path.parent.name.rpartition("-")[0] for path in runs.glob("stages/*/stage.json")}
    assert left == {"full-scene", "scene"}
    results = Results(load_records(tmp_path / "rows"))
    (entry,) = results.entries("ball", "thing", "joint-20", "Joint").values()
    selected = entry.record["selected"]["thing"]
    assert selected["chosen"] == -(-selected["candidates"] // 5)


def test_a_row_that_fails_does_not_stop_the_others(
    done: Path, scene_folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fails(self, row, **rest):  # type: ignore[no-untyped-def]
        raise SceneError(f"No light for {row.name}.")

    monkeypatch.setattr(Bench, "measure", fails)
    assert study(scene_folder, tmp_path, "--rows", *ROWS, "--seeds", "0") == 2
    assert not load_records(tmp_path / "rows")


def test_another_preset_or_size_is_refused(
    done: Path, scene_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert study(scene_folder, done, "--steps", "0.5") == 2
    assert "holds a study with steps 1.0, not 0.5" in capsys.readouterr().err
    assert study(scene_folder, done, "--evaluate-on", "validation") == 2
    assert "holds a study with evaluate_on test, not validation" in capsys.readouterr().err
    assert command.main(["--report-only", "--out", str(done / "none")]) == 2
    assert not (done / "none").exists()


def test_gains_are_over_the_tuned_baseline_where_there_is_one(
    done: Path, scene_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its row may be measured after the others; one more line is ours in its processor time."""
    out = tmp_path / "study"
    shutil.copytree(done, out)
    spent: list[tuple[float, float]] = []

    def factor(theirs: float, ours: float) -> float:
        spent.append((theirs, ours))
        return 2.0

    monkeypatch.setattr(measure, "equal_time_factor", factor)
    before = Results(load_records(out / "rows"))
    rows = ["full-scene-tuned", "matched-tuned", "joint-equal-time", "full-scene-tuned-one-stage"]
    assert study(scene_folder, out, "--rows", *ROWS, *rows, "--seeds", "0") == 0
    results = Results(load_records(out / "rows"))
    assert (before.baseline, results.baseline) == ("Full Scene", "Full Scene, tuned")

    def stat(row: str, model: str, metric: str) -> dict[int, float]:
        return results.stat("ball", "thing", row, model, metric).values

    tuned = stat("full-scene-tuned", "Full Scene, tuned", "roi_psnr")
    plain = stat("full-scene", "Full Scene", "roi_psnr")
    ours = stat("joint", "Joint", "roi_psnr")
    assert set(ours) == {0, 1} and set(tuned) == {0}
    assert stat("joint", "Joint", "gain") == pytest.approx({0: ours[0] - tuned[0]})
    assert stat("joint", "Joint", "full_scene_gain") == pytest.approx(
        {seed: ours[seed] - plain[seed] for seed in (0, 1)}
    )
    assert stat("full-scene-tuned", "Full Scene, tuned", "gain") == {}
    assert stat("full-scene-tuned", "Full Scene, tuned", "cpu_ratio") == {0: 1.0}
    seconds = {
        name: stat(row, name, "cpu_seconds")[0]
        for row, name in (("full-scene-tuned", "Full Scene, tuned"), ("joint", "Joint"))
    }
    (longer,) = results.entries("ball", "thing", "joint-equal-time", "Joint, equal time").values()
    assert set(longer.record["stages"]) == {"full-scene", "scene", "compare-equal-time/joint"}
    scene = longer.record["stages"]["scene"]["cpu_seconds"]
    left = [seconds[name] - scene for name in ("Full Scene, tuned", "Joint")]
    assert spent == [(pytest.approx(left[0]), pytest.approx(left[1]))]
    assert (longer.record["steps"], longer.record["steps_factor"]) == (60, 1.5)
    (matched,) = results.entries("ball", "thing", "matched-tuned", "Matched, tuned").values()
    assert set(matched.record["stages"]) == {"full-scene", "scene", "tuned-matched"}
    page = (out / "study.md").read_text(encoding="utf-8")
    assert "Gains are over Full Scene, tuned" in page and "| over Full Scene |" in page
    assert "Steps times: ball 1.5 (seed 0)" in page
    near = {seed: stat("joint", "Joint", "near_psnr")[seed] for seed in (0, 1)}
    before = stat("full-scene-tuned", "Full Scene, tuned", "near_psnr")
    assert stat("joint", "Joint", "near_gain") == pytest.approx({0: near[0] - before[0]})
    gains = results.entries("ball", "thing", "joint", "Joint")[0].gains.values()
    assert stat("joint", "Joint", "worst_gain") == {0: min(gains)}
    for label in ("Full Scene, tuned, one stage", "Full Scene, tuned, budget-matched"):
        assert f"| {label} |" in page


def test_validation_photos_of_a_study(scene_folder: Path, tmp_path: Path) -> None:
    options = ("--rows", "full-scene", "--seeds", "0", "--evaluate-on", "validation")
    assert study(scene_folder, tmp_path, *options) == 0
    (record,) = load_records(tmp_path / "rows")
    split = json.loads((tmp_path / "runs" / "ball" / "seed-0" / "split.json").read_text("utf-8"))
    assert record["evaluation"]["test_views"] == split["validation"]
    assert set(record["distances"]["thing"]) == set(split["validation"])
    assert not set(split["validation"]) & set(split["test"])
    page = (tmp_path / "study.md").read_text("utf-8")
    assert "evaluated on: validation photos" in page
    assert "on one validation photo" in page and "test photo" not in page


def test_scenes_by_folder_name_or_with_one(scene_folder: Path) -> None:
    boxes = scene_folder / "rois.json"
    texts = [str(scene_folder), f"other={scene_folder}", f"third={scene_folder}:{boxes}"]
    scenes = parse_scenes(texts)
    assert [scene.name for scene in scenes] == ["ball", "other", "third"]
    assert {scene.path for scene in scenes} == {scene_folder}
    assert all([roi.name for roi in scene.rois] == ["thing", "part"] for scene in scenes)
    with pytest.raises(ConfigError, match="Two scenes"):
        parse_scenes([str(scene_folder), str(scene_folder)])
