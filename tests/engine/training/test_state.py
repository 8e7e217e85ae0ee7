"""A forged checkpoint: well formed and with valid checksums, but nothing that training wrote."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from roigs_engine.context import Context
from roigs_engine.errors import RunFolderError
from roigs_engine.formats.events import Event, Message
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.training.checkpoint import check_state, load_checkpoint, save_checkpoint
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms.box_density_control import BoxDensityControl
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.mechanisms.idle_pruning import IdlePruning
from roigs_engine.training.mechanisms.masked_steps import MaskedSteps
from roigs_engine.training.mechanisms.model_averaging import ModelAveraging
from roigs_engine.training.mechanisms.opacity_decay import OpacityDecay
from roigs_engine.training.mechanisms.surroundings_rate import SurroundingsRate
from roigs_engine.training.stage_data import StageData
from roigs_engine.training.trainer import Trainer
from tests.engine.synthetic_scene import BOX, make_scene, stage_data

CONFIG = TrainConfig(
    steps=20,
    mechanisms=(
        DensityControl(start=2, until=15, every=5),
        IdlePruning(every=100),
        ModelAveraging(steps=20),
        OpacityDecay(),
    ),
)
MASKED = TrainConfig(
    steps=20,
    mechanisms=(MaskedSteps(), SurroundingsRate(), BoxDensityControl(start=0, budgets=(50,))),
)
State = dict[str, Any]


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> State:
    """The state of a stage after 12 steps."""
    scene = make_scene(tmp_path_factory.mktemp("state"), views=4)
    photos = [
        np.zeros((image.camera.height, image.camera.width, 3), np.uint8) for image in scene.images
    ]

    class Photos(list[Any]):
        def prefetch(self, indices: object) -> None:
            """Nothing to do."""

    data = StageData(
        images=scene.images, photos=Photos(photos), photo_at=lambda step: step % 4, extent=1.0
    )
    trainer = Trainer(Gaussians.from_points(scene.points, scene.colors), data, CONFIG)
    for _ in range(12):
        trainer.train_step()
    return trainer.state_dict()


def put(*path: str, value: Any) -> Callable[[State], None]:
    """Sets a value, or removes it if the value is `...`."""

    def change(state: State) -> None:
        for key in path[:-1]:
            state = state[key]
        if value is ...:
            del state[path[-1]]
        else:
            state[path[-1]] = value(state[path[-1]]) if callable(value) else value

    return change


def spoilt(number: float) -> Callable[[torch.Tensor], torch.Tensor]:
    def spoil(tensor: torch.Tensor) -> torch.Tensor:
        tensor = tensor.clone()
        tensor.view(-1)[-1] = number
        return tensor

    return spoil


AVERAGING = "mechanisms", "model_averaging"
VIEWS = "mechanisms", "density_control", "views"
FORGED = {
    "step text": put("step", value="3"),
    "step true": put("step", value=True),
    "step negative": put("step", value=-1),
    "step beyond the end": put("step", value=21),
    "step huge": put("step", value=10**300),
    "seconds none": put("seconds", value=None),
    "seconds infinite": put("cpu_seconds", value=math.inf),
    "seconds of 400 digits": put("seconds", value=10**400),
    "loss a list": put("loss", value=[1.0]),
    **{f"no {key}": put(key, value=...) for key in ("step", "loss", "parameters", "mechanisms")},
    **{f"{key} a number": put(key, value=3) for key in ("parameters", "optimizer", "mechanisms")},
    "no means": put("parameters", "means", value=...),
    "means a number": put("parameters", "means", value=1.5),
    "means of another type": put("parameters", "means", value=torch.Tensor.double),
    "means NaN": put("parameters", "means", value=spoilt(math.nan)),
    "scales Inf": put("parameters", "log_scales", value=spoilt(math.inf)),
    "fewer rows": put("parameters", "quats", value=lambda t: t[:-1]),
    "no rows": put("parameters", "means", value=lambda t: t[:0]),
    "two bands": put("parameters", "sh", value=lambda t: t[:, :2]),
    "flat": put("parameters", "sh", value=torch.Tensor.flatten),
    "another parameter": lambda state: state["parameters"].update(colour=torch.zeros(3)),
    "moments of other rows": put("optimizer", "exp_avg", "means", value=lambda t: t[:-1]),
    "no moments": put("optimizer", "exp_avg_sq", value={}),
    "moments NaN": put("optimizer", "exp_avg", "sh", value=spoilt(math.nan)),
    "negative squares": put("optimizer", "exp_avg_sq", "sh", value=spoilt(-1.0)),
    "rates of another width": put("optimizer", "rates", "sh", value=lambda t: t[:7]),
    "rates negative": put("optimizer", "rates", "means", value=spoilt(-1.0)),
    "rates infinite": put("optimizer", "rates", "means", value=spoilt(math.inf)),
    "steps of Adam": put("optimizer", "step_count", value=-(1 << 70)),
    "sums of other rows": put(*AVERAGING, "sum_means", value=lambda t: t[:1]),
    "sums missing": put(*AVERAGING, "sum_means", value=...),
    "sums of no models": put(*AVERAGING, "count", value=0),
    "sums not a dict": put(*AVERAGING, value=1.5),
    "sums counted": put(*AVERAGING, "count", value=1.5),
    "window ahead": put("mechanisms", "idle_pruning", "window", value=13),
    "no statistics": put("mechanisms", "density_control", value=...),
    "no gradients": put("mechanisms", "density_control", "gradient", value=...),
    "statistics of other rows": put(*VIEWS, value=lambda t: t[:-1]),
    "statistics of another type": put(*VIEWS, value=torch.Tensor.int),
    "statistics NaN": put("mechanisms", "idle_pruning", "weight", value=spoilt(math.nan)),
    "another mechanism": lambda state: state["mechanisms"].update(other={}),
    "more of one": lambda state: state["mechanisms"]["opacity_decay"].update(more=1),
}  # fmt: skip


def test_what_training_wrote_passes(good: State, tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "checkpoint.bin", good, "one")
    check = partial(check_state, config=CONFIG)
    state = load_checkpoint(tmp_path / "checkpoint.bin", "one", check=check)
    assert state["step"] == 12


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_one_counts_as_damaged(name: str, good: State, tmp_path: Path) -> None:
    path, forged = tmp_path / "checkpoint.bin", copy.deepcopy(good)
    FORGED[name](forged)
    save_checkpoint(path, good, "one")
    save_checkpoint(path, forged, "one")
    events: list[Event] = []
    check = partial(check_state, config=CONFIG)
    state = load_checkpoint(path, "one", Context(emit=events.append), check)
    assert torch.equal(state["parameters"]["means"], good["parameters"]["means"])
    (warning,) = events
    assert isinstance(warning, Message) and "is damaged (" in warning.text
    path.with_name("checkpoint.before.bin").unlink()
    with pytest.raises(RunFolderError, match=r"checkpoint\.bin is damaged \(.*\)\. Delete it"):
        load_checkpoint(path, "one", check=check)


OUTSIDE = "mechanisms", "surroundings_rate", "outside"
FORGED_OUTSIDE = {
    "missing": put(*OUTSIDE, value=...),
    "none": put(*OUTSIDE, value=None),
    "a number": put(*OUTSIDE, value=2.0),
    "of other rows": put(*OUTSIDE, value=lambda t: t[:-1]),
    "of another type": put(*OUTSIDE, value=torch.Tensor.float),
    "budgets of more boxes": put(
        *("mechanisms", "box_density_control", "began"), value=lambda t: torch.cat([t, t])
    ),
    "no budgets": put("mechanisms", "box_density_control", "began", value=...),
}


@pytest.mark.parametrize("name", FORGED_OUTSIDE)
def test_a_forged_one_of_a_box_stage(name: str, tmp_path: Path) -> None:
    scene = make_scene(tmp_path, views=4)
    model = Gaussians.from_points(scene.points, scene.colors)
    state = Trainer(model, stage_data(scene, rois=[BOX]), MASKED).state_dict()
    check_state(state, MASKED)
    FORGED_OUTSIDE[name](state)
    with pytest.raises(ValueError, match=r"outside|began"):
        check_state(state, MASKED)
