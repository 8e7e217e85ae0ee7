"""Mechanisms of training: a new one is one class, which the trainer needs not know."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import pytest

from roigs_engine.context import Context
from roigs_engine.errors import ConfigError
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import SfmScene
from roigs_engine.run.definition import define_run
from roigs_engine.training import mechanisms
from roigs_engine.training.checkpoint import check_state, load_checkpoint, save_checkpoint
from roigs_engine.training.config import Mechanism, TrainConfig, limited, share_of_steps, with_steps
from roigs_engine.training.mechanisms.model_averaging import ModelAveraging
from roigs_engine.training.running import Running
from roigs_engine.training.trainer import Trainer
from tests.engine.runs import tiny
from tests.engine.synthetic_scene import BOX, make_scene, stage_data
from tests.engine.training.short import SHORT, first_model, same_bits

if TYPE_CHECKING:
    from roigs_engine.training.running import Training
    from roigs_engine.training.state_reader import StateReader


@dataclass(frozen=True, kw_only=True)
class Drift(Mechanism):
    """Moves all Gaussians a little, farther each time, until a step."""

    name: ClassVar[str] = "drift"

    by: float = limited(0.01, above=0)
    until: int = share_of_steps(40)

    def begin(self, config: TrainConfig, training: Training) -> Running:
        return Drifting(self)

    def check_state(self, state: StateReader) -> None:
        state.count("moves", state.step)
        state.tensors({}, besides=("moves",))


class Drifting(Running):
    kept = ("moves",)

    def __init__(self, settings: Drift) -> None:
        self.settings, self.moves = settings, 0

    def is_due(self, step: int) -> bool:
        return step < self.settings.until and step % 7 == 0

    def after_step(self, training: Training) -> None:
        self.moves += 1
        training.gaussians.means.add_(self.settings.by * self.moves)


CONFIG = SHORT.using(Drift())


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    return make_scene(tmp_path_factory.mktemp("photos"))


def trained(scene: SfmScene, config: TrainConfig) -> Trainer:
    trainer = Trainer(first_model(scene), stage_data(scene), config)
    assert trainer.run()
    return trainer


def test_a_new_one_acts(scene: SfmScene) -> None:
    trainer = trained(scene, CONFIG)
    assert trainer.state_dict()["mechanisms"]["drift"] == {"moves": 5}
    assert not same_bits(trainer.gaussians, trained(scene, SHORT).gaussians)


@pytest.mark.parametrize("stop", [6, 7, 8, 30])
def test_it_resumes_bit_for_bit(scene: SfmScene, tmp_path: Path, stop: int) -> None:
    half = Trainer(first_model(scene), stage_data(scene), CONFIG)
    assert not half.run(Context(should_stop=lambda: half.step >= stop))
    save_checkpoint(tmp_path / "checkpoint.bin", half.state_dict(), "same")
    state = load_checkpoint(tmp_path / "checkpoint.bin", "same")
    check_state(state, CONFIG)
    rest = Trainer(Gaussians(**state["parameters"]), stage_data(scene), CONFIG)
    rest.load_state_dict(state)
    assert rest.run()
    assert same_bits(rest.gaussians, trained(scene, CONFIG).gaussians)
    state["mechanisms"]["drift"]["moves"] = stop + 1
    with pytest.raises(ValueError, match="moves"):
        check_state(state, CONFIG)


def test_manifest_fingerprint_and_schedule_follow(scene: SfmScene, tmp_path: Path) -> None:
    config = tiny("joint")
    drifting = replace(config, scene=config.scene.using(Drift(by=0.5)))
    run = define_run(tmp_path, scene, [BOX], drifting)
    record = run.manifest()["config"]["scene"]["mechanisms"]
    assert record["drift"] == {"by": 0.5, "until": 40}
    assert list(record) == ["density_control", "drift"]  # in their order
    assert with_steps(CONFIG, 30).of(Drift).until == 20
    with pytest.raises(ConfigError, match="by is -1"):
        CONFIG.using(Drift(by=-1.0))


def test_a_stage_has_one_of_a_kind() -> None:
    with pytest.raises(ConfigError, match="two of drift"):
        TrainConfig(steps=1, mechanisms=(Drift(), Drift(by=1.0)))
    first, *others = TrainConfig(steps=1).using(Drift(), ModelAveraging(), Drift(by=1.0)).mechanisms
    assert first == Drift(by=1.0) and others == [ModelAveraging()]
    with pytest.raises(ConfigError, match="The stage needs drift"):
        SHORT.of(Drift)


def test_each_says_what_it_earns_and_has_a_name_of_its_own() -> None:
    names = [module.name for module in pkgutil.iter_modules(mechanisms.__path__)]
    for name in names:
        module = importlib.import_module(f"{mechanisms.__name__}.{name}")
        (kind,) = (
            each
            for each in vars(module).values()
            if isinstance(each, type)
            and issubclass(each, Mechanism)
            and each.__module__ == module.__name__
        )
        assert kind.name == name
        assert "\nEarns: " in str(inspect.getdoc(kind))
