"""Two models of one scene, one of them with wrong colours."""

from __future__ import annotations

from roigs_engine.evaluation.views import EvaluatedModel
from tests.engine.synthetic_scene import truth

TEST = ("000.png", "001.png", "002.png", "004.png")


def two_models() -> list[EvaluatedModel]:
    worse = truth()
    worse.sh[:, 0, 0] += 0.3
    return [
        EvaluatedModel(name="Full Scene", gaussians=worse, seconds=1.0),
        EvaluatedModel(name="Ours", gaussians=truth(), seconds=1.0),
    ]
