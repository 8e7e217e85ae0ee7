"""Everything that takes long asks between its steps whether to stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import Context
from roigs_engine.errors import Stopped
from roigs_engine.evaluation.crops import write_crops
from roigs_engine.evaluation.evaluate import evaluate
from roigs_engine.evaluation.views import EvaluatedModel
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import SfmScene
from roigs_engine.selection.split import choose_test_views
from roigs_engine.training.loop import PeriodicCallback
from roigs_engine.training.mechanisms.box_density_control import box_budgets
from tests.engine.synthetic_colmap import camera, write_project
from tests.engine.synthetic_scene import BOX, make_scene

NAMES = [f"{index}.png" for index in range(6)]
THREADS = 8


class Asked:
    """Counts how often it is asked whether to stop, and says so at the given call."""

    def __init__(self, stop_at: int = 0) -> None:
        self.calls, self._stop_at = 0, stop_at

    def __call__(self) -> bool:
        self.calls += 1
        return self.calls == self._stop_at


def asks_often(work: Callable[[Context], object], least: int, *, waits: bool = False) -> None:
    """`work` asks at least so many times, and stops wherever it asks.

    Where it `waits` for others it also asks meanwhile, another number of times in each run.
    """
    counted = Asked()
    work(Context(should_stop=counted))
    assert counted.calls >= least
    surely = least if waits else counted.calls
    for stop_at in (1, surely // 2, surely):
        stopping = Asked(stop_at)
        with pytest.raises(Stopped):
            work(Context(should_stop=stopping))
        late = THREADS if waits else 0  # others that were about to ask
        assert stop_at <= stopping.calls <= stop_at + late


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"), views=6)


@pytest.mark.parametrize("binary", [True, False])
def test_loading(tmp_path: Path, binary: bool) -> None:
    project = write_project(tmp_path, names=NAMES, binary=binary)
    asks_often(
        lambda context: load_colmap(project.folder, context=context), 3 * len(NAMES), waits=True
    )


def test_undistorting(tmp_path: Path) -> None:
    lens = camera("OPENCV", params=[100.0, 90.0, 45.0, 40.0, 0.05, 0.01, 0.001, 0.002])
    write_project(tmp_path, names=NAMES, cameras=[lens])
    caches = iter(range(9))

    def load(context: Context) -> None:
        load_colmap(tmp_path, cache=tmp_path / f"cache {next(caches)}", context=context)

    asks_often(load, 4 * len(NAMES), waits=True)


def test_choosing_test_photos(scene: SfmScene) -> None:
    blind = replace(scene, has_tracks=False)
    asks_often(lambda context: choose_test_views(blind, [BOX], 3, context), len(scene.images))


def test_counting_a_boxes_pixels(scene: SfmScene) -> None:
    asks_often(lambda c: box_budgets(scene.images, [BOX], 32.0, c), len(scene.images))


def test_evaluating_and_drawing(scene: SfmScene, tmp_path: Path) -> None:
    model = Gaussians.from_points(scene.points, scene.colors)
    models = [EvaluatedModel(name=name, gaussians=model, seconds=1.0) for name in ("a", "b")]
    test = [image.name for image in scene.images[:3]]
    asks_often(lambda context: evaluate(models, scene, test, [BOX], context=context), 3 * 2)
    evaluation = evaluate(models, scene, test, [BOX], baseline="a")
    asks_often(
        lambda context: write_crops(evaluation, models, scene, [BOX], tmp_path, context=context), 4
    )


def test_callbacks_come_in_time_and_take_a_tenth_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    now, taken = 0.0, []

    def slow() -> None:
        nonlocal now
        taken.append(trained)
        now += 2.0

    monkeypatch.setattr("time.perf_counter", lambda: now)
    rest, never = PeriodicCallback(5.0, slow), PeriodicCallback(0.0, slow)
    for trained in range(50):
        spent = rest.call_if_due(float(trained)) + never.call_if_due(float(trained))
        assert spent == (2.0 if trained in taken else 0.0)
    assert taken == [5, 23, 41]
