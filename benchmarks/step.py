"""How long a training step takes: `python -m benchmarks.step` (nothing else should run meanwhile).

A synthetic scene: textured surfaces of a ground, some balls and a far shell, seen from a ring of
cameras. Each stage's figure is the median over cameras of the fastest repeat, in milliseconds of
wall-clock time, and in brackets of process-CPU time.
"""

from __future__ import annotations

import argparse
import platform
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch

from roigs_engine.densify import morton_order
from roigs_engine.gaussians import NAMES, SH_C0, Gaussians
from roigs_engine.kernels import library
from roigs_engine.losses import photo_loss
from roigs_engine.optimizer import VisibleAdam
from roigs_engine.rasterize import rasterize

CAMERAS, REPEATS = 8, 5
STAGES = ("render", "loss", "backward", "adam", "step")


def synthetic_gaussians(count: int, seed: int = 0) -> Gaussians:
    """Flat Gaussians on surfaces: 40 % ground, 40 % balls on it, 20 % a shell far away."""
    rng = np.random.default_rng(seed)
    kind = np.sort(rng.choice(3, count, p=[0.4, 0.4, 0.2]))
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ball = rng.integers(0, 6, count)
    turns = np.arange(6) * np.pi / 3
    centres = np.stack([1.3 * np.cos(turns), 1.3 * np.sin(turns), np.full(6, 0.5)], axis=1)
    means = np.where((kind == 1)[:, None], centres[ball] + 0.5 * directions, 13.0 * directions)
    radius, angle = 4.5 * np.sqrt(rng.uniform(size=count)), rng.uniform(0, 2 * np.pi, count)
    ground = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.05 * np.sin(radius)], 1)
    means = np.where((kind == 0)[:, None], ground, means)
    area = np.array([64.0, 6 * 3.1, 2100.0])[kind] / np.bincount(kind, minlength=3)[kind]
    scales = 0.8 * np.sqrt(area)[:, None] * np.exp(rng.normal(size=(count, 3)) * 0.4)
    scales[:, 2] *= 0.2
    sh = rng.normal(size=(count, 16, 3)) * 0.04
    sh[:, 0] = (rng.uniform(0.05, 0.95, (count, 3)) - 0.5) / SH_C0
    opacities = np.where(rng.uniform(size=count) < 0.45, rng.beta(1.2, 5, count), 0.8)
    arrays = {
        "means": means,
        "quats": rng.normal(size=(count, 4)),
        "log_scales": np.log(scales),
        "logit_opacities": np.log(opacities / (1 - opacities)),
        "sh": sh,
    }
    model = Gaussians.from_arrays({name: a.astype(np.float32) for name, a in arrays.items()})
    return model.rows(morton_order(model.means))


def ring_cameras() -> torch.Tensor:
    """(CAMERAS, 4, 4) world_to_camera, looking at the middle from around it."""
    poses = []
    for angle in np.arange(CAMERAS) * 2 * np.pi / CAMERAS:
        eye = np.array([4.4 * np.cos(angle), 4.4 * np.sin(angle), 1.6])
        forward = np.array([0, 0, 0.5]) - eye
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ eye
        poses.append(pose)
    return torch.from_numpy(np.array(poses)).float()


def measure(count: int, width: int, height: int) -> dict[str, tuple[float, float]]:
    """Stage -> (wall, CPU) milliseconds, as the module says."""
    model = synthetic_gaussians(count)
    tensors = {n: getattr(model, n).requires_grad_() for n in NAMES}
    optimizer = VisibleAdam({n: (t, 0.0) for n, t in tensors.items()})
    focal = 0.87 * width
    intrinsics = torch.tensor([[[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]])
    target = torch.randint(0, 256, (height, width, 3), dtype=torch.uint8)
    best: dict[str, list[list[tuple[float, float]]]] = {s: [] for s in STAGES}
    for pose in ring_cameras():
        runs = [_step(tensors, optimizer, pose, intrinsics, target) for _ in range(REPEATS)]
        for stage in STAGES:
            best[stage].append([run[stage] for run in runs])
    return {
        stage: (
            statistics.median(min(wall for wall, _ in runs) for runs in cameras),
            statistics.median(min(cpu for _, cpu in runs) for runs in cameras),
        )
        for stage, cameras in best.items()
    }


def _step(
    tensors: dict[str, torch.Tensor],
    optimizer: VisibleAdam,
    pose: torch.Tensor,
    intrinsics: torch.Tensor,
    target: torch.Tensor,
) -> dict[str, tuple[float, float]]:
    taken: dict[str, tuple[float, float]] = {}

    def timed(stage: str, work: Callable[[], object]) -> object:
        wall, cpu = time.perf_counter(), time.process_time()
        result = work()
        taken[stage] = 1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - cpu)
        return result

    height, width = target.shape[:2]
    output = timed(
        "render",
        lambda: rasterize(*tensors.values(), pose[None], intrinsics, width, height, raw=True),
    )
    loss = timed("loss", lambda: photo_loss(output.image, target))
    timed("backward", lambda: loss.loss.backward())
    timed("adam", lambda: optimizer.step(output.visible[0]))
    taken["step"] = tuple(sum(times) for times in zip(*taken.values(), strict=True))
    return taken


def main() -> None:
    """Print one Markdown row per number of Gaussians and of threads."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gaussians", type=int, nargs="+", default=[50_000, 200_000])
    parser.add_argument("--size", type=int, nargs=2, default=[480, 320], metavar=("W", "H"))
    parser.add_argument("--threads", type=int, nargs="+", default=[1, library.usable_cores()])
    args = parser.parse_args()
    torch.set_num_threads(1)
    print(f"{platform.machine()}, {library.isa()}, {args.size[0]} x {args.size[1]}, ms wall (CPU)")
    print(f"| Gaussians | threads | {' | '.join(STAGES)} |")
    print(f"|---|---|{'---|' * len(STAGES)}")
    for count in args.gaussians:
        for threads in args.threads:
            library.set_threads(threads)
            taken = measure(count, *args.size)
            cells = [f"{wall:.1f} ({cpu:.1f})" for wall, cpu in taken.values()]
            print(f"| {count:,} | {threads} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
