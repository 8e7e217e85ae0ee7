"""A training of eight steps, for tests that run it on a GPU and a CPU."""

from __future__ import annotations

from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.scene import SfmScene
from roigs_engine.training.config import TrainConfig
from roigs_engine.training.mechanisms.density_control import DensityControl
from roigs_engine.training.trainer import Trainer
from tests.engine.synthetic_scene import stage_data

CONFIG = TrainConfig(
    steps=8,
    mechanisms=(DensityControl(start=2, until=6, every=2, grad_threshold=1e-5),),
)


def trained(scene: SfmScene, config: TrainConfig = CONFIG) -> Trainer:
    start = Gaussians.from_points(scene.points[::6], scene.colors[::6])
    trainer = Trainer(start, stage_data(scene), config)
    assert trainer.run()
    return trainer
