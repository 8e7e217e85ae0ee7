"""A model keeps its target through all operations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from roigs_engine.errors import ConfigError
from roigs_engine.formats.targets import CYCLES, EEVEE, PLAIN, TARGETS, VIEWERS, Target
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.local_frame import LocalFrame


def model(target: Target) -> Gaussians:
    random = np.random.default_rng(0)
    arrays = {
        "means": random.normal(size=(5, 3)),
        "quats": random.normal(size=(5, 4)),
        "log_scales": random.normal(size=(5, 3)),
        "logit_opacities": random.normal(size=5),
        "sh": random.normal(size=(5, 4, 3)),
    }
    return Gaussians.from_arrays(arrays, target=target)


@pytest.mark.parametrize("target", TARGETS.values(), ids=lambda target: target.name)
def test_every_copy_keeps_it(tmp_path: Path, target: Target) -> None:
    made = model(target)
    path, frame = tmp_path / "a.ply", LocalFrame(origin=np.array([3.0, 0, 0]), scale=2.0)
    made.save_ply(path)
    for copy in (
        made,
        made.rows(torch.tensor([1, 3])),
        made.detached(),
        made.to(torch.device("cpu")),
        made.with_tensors({"sh": made.sh[:, :1]}),
        Gaussians.concatenate([made, made]),
        Gaussians.load_ply(path),
        Gaussians.load_ply(path, frame),
        Gaussians.load_framed(path)[0],
        Gaussians.load_framed(path, scaled=False)[0],
    ):
        assert copy.target == target


@pytest.mark.parametrize("other", [PLAIN, CYCLES, EEVEE], ids=lambda target: target.name)
def test_two_kinds_make_no_single_model(other: Target) -> None:
    with pytest.raises(ConfigError, match=f"made for {VIEWERS.title}, others for {other.title}"):
        Gaussians.concatenate([model(VIEWERS), model(other)])
