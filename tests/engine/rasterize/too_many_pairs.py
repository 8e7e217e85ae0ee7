"""A view with too many pairs of Gaussians and tiles, as `python -m`: its error and most memory."""

from __future__ import annotations

import torch

from benchmarks.memory import resident
from roigs_engine.errors import KernelError
from roigs_engine.rasterize import rasterize

COUNT = 34_000

if __name__ == "__main__":
    means = torch.tensor([[0.0, 0.0, 2.0]]).repeat(COUNT, 1)
    quats = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(COUNT, 1)
    shapes = torch.full((COUNT, 3), 2.0), torch.full((COUNT,), 0.9), torch.zeros(COUNT, 1, 3)
    lens = torch.tensor([[[7000.0, 0.0, 3840.0], [0.0, 7000.0, 2160.0], [0.0, 0.0, 1.0]]])
    try:
        rasterize(means, quats, *shapes, torch.eye(4)[None], lens, 7680, 4320)
    except KernelError as error:
        print(error.args[0])
    print(resident("VmHWM"))
