"""Training that diverges is tried again and then stops; warnings name photos that do not fit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from roigs_engine.context import Context
from roigs_engine.errors import Stopped, TrainingError
from roigs_engine.formats.events import Event, Message
from roigs_engine.model.scene import SfmScene
from roigs_engine.run import stage_folder
from roigs_engine.run.stage_folder import StageFolder, StageResult
from roigs_engine.training import trainer
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.metrics import Health
from roigs_engine.training.trainer import Trainer
from tests.engine.synthetic_scene import make_scene, stage_data
from tests.engine.training.short import SHORT, first_model, same_bits

STEP = 33  # where something goes wrong; Gaussians are added every ten steps


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


def train(scene: SfmScene, folder: Path, events: list[Event], stop_at: int = -1) -> StageResult:
    asked = iter(range(1000))
    folder_of_stage = StageFolder(name="scene", folder=folder, fingerprint="one")
    context = Context(emit=events.append, should_stop=lambda: next(asked) == stop_at)
    done = folder_of_stage.finished(context)
    start = first_model(scene)
    return done or folder_of_stage.train(lambda: start, stage_data(scene), SHORT, context)


def warnings(events: list[Event]) -> list[str]:
    return [e.text for e in events if isinstance(e, Message) and e.level == "warning"]


@pytest.fixture(params=["loss", "gradient", "parameter", "infinite parameter"])
def go_wrong(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Callable[[int], None]:
    """Has something go wrong at `STEP`, so many times."""

    def prepare(times: int) -> None:
        left = iter(range(times))
        step, photo_loss = Trainer.train_step, trainer.photo_loss
        here = False

        def train_step(self: Trainer) -> None:
            nonlocal here
            here = self.step == STEP and next(left, None) is not None
            if here and "parameter" in request.param:
                bad = np.inf if "infinite" in request.param else np.nan
                self.gaussians.log_scales.data[5] = bad
            step(self)

        def spoiled(*args: object, **options: object) -> object:
            output = photo_loss(*args, **options)  # type: ignore[arg-type]
            if here and request.param == "loss":
                return output._replace(loss=output.loss * np.nan)
            if here and request.param == "gradient":
                args[0].register_hook(lambda gradient: gradient * np.inf)  # type: ignore[attr-defined]
            return output

        monkeypatch.setattr(Trainer, "train_step", train_step)
        monkeypatch.setattr(trainer, "photo_loss", spoiled)

    return prepare


def test_a_transient_fault_is_retried(
    scene: SfmScene, tmp_path: Path, go_wrong: Callable[[int], None]
) -> None:
    whole = train(scene, tmp_path / "whole", [])
    with pytest.raises(Stopped):
        train(scene, tmp_path / "run", [], stop_at=20)
    go_wrong(1)
    events: list[Event] = []
    result = train(scene, tmp_path / "run", events)
    (text,) = warnings(events)
    assert text.endswith("Trying again from the last checkpoint.")
    assert f"step {STEP}" in text or ("step 40" in text and "NaN or Inf in" in text)
    resumed = [e.text for e in events if isinstance(e, Message) and "resumes at" in e.text]
    assert resumed == ["scene: resumes at step 20."] * 2
    assert same_bits(result.gaussians, whole.gaussians)


def test_what_happens_again_stops_training(
    scene: SfmScene, tmp_path: Path, go_wrong: Callable[[int], None]
) -> None:
    go_wrong(2)
    events: list[Event] = []
    with pytest.raises(TrainingError, match=rf"step {STEP}|step 40") as raised:
        train(scene, tmp_path, events)
    (again,) = warnings(events)
    assert raised.value.hint and again.endswith("Trying again from the start.")
    assert not (tmp_path / "stage.json").exists()


def test_a_stage_that_was_stopped_before_its_first_step_starts(
    scene: SfmScene, tmp_path: Path
) -> None:
    events: list[Event] = []
    with pytest.raises(Stopped):
        train(scene, tmp_path, events, stop_at=0)
    assert (tmp_path / "checkpoint.bin").exists()
    with pytest.raises(Stopped):
        train(scene, tmp_path, events, stop_at=3)
    with pytest.raises(Stopped):
        train(scene, tmp_path, events, stop_at=2)
    said = [e.text for e in events if isinstance(e, Message)]
    assert said == ["scene: starts at step 0.", "scene: resumes at step 3."]


def test_a_state_that_is_not_well_is_not_saved(
    scene: SfmScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved: list[int] = []
    monkeypatch.setattr(stage_folder, "save_checkpoint", lambda path, state, _: saved.append(state))
    well = Trainer(first_model(scene), stage_data(scene), SHORT)
    stage = StageFolder(name="scene", folder=tmp_path, fingerprint="one")
    well.train_step()
    stage._save(well)
    well.gaussians.means.data[0, 0] = np.nan
    with pytest.raises(TrainingError, match="`means` of 1 Gaussians"):
        stage._save(well)
    assert len(saved) == 1


def visits(health: Health, losses: dict[int, float], rounds: int = 6) -> Health:
    rng = np.random.default_rng(0)
    order: Iterator[tuple[int, int]] = enumerate(list(losses) * rounds)
    for step, photo in order:
        health.record_loss(step, photo, torch.tensor(losses[photo] * rng.uniform(0.9, 1.1)))
    return health


def test_a_photo_whose_loss_stays_high_is_named() -> None:
    names = [f"{k}.jpg" for k in range(20)]
    normal = {k: 0.05 + 0.002 * k for k in range(20)}
    assert not visits(Health(names), normal).outliers()
    text = visits(Health(names), normal | {7: 0.4}).outliers()
    assert text.startswith("1 photo fit worse") and "'7.jpg'" in text and "(loss up to 0.4" in text
    many = visits(Health(names), normal | {k: 0.4 + k / 5 for k in range(1, 8)}).outliers()
    assert many.startswith("7 photos fit worse") and "'7.jpg', '6.jpg'" in many and "4 more" in many
    once = visits(Health(names), normal)
    once.record_loss(999, 7, torch.tensor(0.4))  # on one visit only
    assert not once.outliers()
    assert not visits(Health(names), {0: 0.1, 1: 0.1, 2: 0.9}).outliers()  # too few to compare


def test_a_photo_is_named_once() -> None:
    names = [f"{k}.jpg" for k in range(20)]
    normal, named = {k: 0.05 + 0.002 * k for k in range(20)}, set[str]()
    bad = normal | {k: 0.4 + k / 5 for k in range(6)}
    assert visits(Health(names), bad).outliers(named).startswith("6 photos fit worse")
    assert named == set(names[:6])
    assert not visits(Health(names), bad).outliers(named)
    text = visits(Health(names), bad | {7: 0.4}).outliers(named)
    assert text.startswith("1 photo fit worse") and "'7.jpg' (loss up to 0.4" in text


def test_a_photo_of_something_else_is_named(scene: SfmScene) -> None:
    class OneNoisy:
        def __init__(self, photos: object) -> None:
            self._photos = photos

        def __getitem__(self, index: int) -> np.ndarray:
            pixels = self._photos[index]  # type: ignore[index]
            noise = 255 * np.random.default_rng(0).integers(0, 2, pixels.shape, dtype=np.uint8)
            return noise if index == 4 else pixels

        def prefetch(self, indices: object) -> None:
            pass

    config = TrainConfig(steps=150)
    good = Trainer(first_model(scene), stage_data(scene), config)
    good.run()
    assert not good.health.outliers()
    data = stage_data(scene, photos=OneNoisy(good.data.photos))
    bad = Trainer(first_model(scene), data, config)
    bad.run()
    text = bad.health.outliers()
    assert f"'{scene.images[4].name}'" in text
