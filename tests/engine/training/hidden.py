"""A Gaussian that others come to hide keeps its optimizer state."""

from __future__ import annotations

from typing import Any

import torch

from roigs_engine.rasterize import RenderOutput, rasterize
from roigs_engine.rasterize.limits import TRAINING_LIMITS
from roigs_engine.training.optimizer import VisibleAdam
from tests.engine.rasterize_cases import cameras

SIZE = (61, 43)


def render(model: VisibleAdam, *, views: int = 1, **options: Any) -> RenderOutput:
    poses, intrinsics = (t[:views] for t in cameras(*SIZE))
    given = {"backward_step": model.backward_step, **options}
    return rasterize(*model.parameters.values(), poses, intrinsics, *SIZE, raw=True, **given)


def keeps_what_others_hide(backend: str) -> None:
    """The last of three walls takes a step; in the next one, the others hide it."""
    parameters = {
        "means": torch.tensor([[0.0, 0.0, 4.0], [0.0, 0.0, 5.0], [0.0, 0.0, 6.0]]),
        "quats": torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(3, 1),
        "log_scales": torch.tensor([[4.0, 4.0, -4.0]]).repeat(3, 1),
        "logit_opacities": torch.tensor([3.0, 3.0, 3.0]),
        "sh": torch.full((3, 1, 3), 0.3),
    }
    optimizer = VisibleAdam({name: (p, 0.01) for name, p in parameters.items()})
    states = []
    for _ in range(2):
        output = render(optimizer, limits=TRAINING_LIMITS, backend=backend)
        assert bool(output.visible.all())
        output.image.mean().backward()
        states.append(
            {
                f"{kind} {name}": tensors[name][2].detach().clone()
                for kind in ("parameters", "exp_avg", "exp_avg_sq")
                for name, tensors in ((n, getattr(optimizer, kind)) for n in parameters)
            }
        )
        with torch.no_grad():
            optimizer.parameters["logit_opacities"][:2] = 5.0  # 5e-5 of the light passes both
    first, second = states
    assert first["exp_avg sh"].any()
    for name, tensor in first.items():
        assert torch.equal(tensor, second[name]), name
