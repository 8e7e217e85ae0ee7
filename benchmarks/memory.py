"""Memory of a training: `python -m benchmarks.memory` (Linux).

Synthetic Gaussians train on synthetic photos that lie on disk as JPEG files, with the engine's own
cache and trainer, in a fresh process for each of two settings: one keeps the number of Gaussians,
the other begins with half of it and densifies every ten steps. Resident memory is the kernel's
count (VmRSS, VmHWM); the rows below it are what the sizes of the known arrays come to.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.markdown import table

if TYPE_CHECKING:
    from roigs_engine.model.scene import PosedImage
    from roigs_engine.training.trainer import Trainer

MIB = 1 << 20
STATUS = Path("/proc/self/status")


def resident(field: str = "VmRSS") -> float:
    """Resident memory in MiB: now, or the peak (`VmHWM`)."""
    lines = STATUS.read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(f"{field}:")) / 1024


def write_photos(folder: Path, count: int, width: int, height: int) -> None:
    """Write photos of smooth colours with noise, so that files are as large as a photo's."""
    import numpy as np
    from PIL import Image

    rng = np.random.default_rng(0)
    for k in range(count):
        coarse = Image.fromarray(rng.integers(0, 256, (12, 18, 3), dtype=np.uint8))
        smooth = np.asarray(coarse.resize((width, height), Image.Resampling.BICUBIC), np.int16)
        noisy = smooth + rng.integers(-12, 13, smooth.shape)
        pixels = Image.fromarray(noisy.clip(0, 255).astype(np.uint8))
        pixels.save(folder / f"{k:03d}.jpg", quality=92)


def train(folder: Path, args: argparse.Namespace, densify: bool) -> None:
    """Train in this process, and print one row per moment and per kind of array."""
    rows = [("start of Python", resident())]
    import torch  # noqa: F401 - to measure it

    rows.append(("torch imported", resident()))
    from benchmarks.synthetic import synthetic_gaussians
    from benchmarks.training import all_photos
    from roigs_engine.kernels import library
    from roigs_engine.photos.cache import PhotoCache
    from roigs_engine.training.config import TrainConfig
    from roigs_engine.training.mechanisms.density_control import DensityControl
    from roigs_engine.training.trainer import Trainer

    library.set_threads(args.threads)
    rows.append(("engine imported, kernels loaded", resident()))
    images = posed(sorted(folder.glob("*.jpg")), *args.size)
    cache = PhotoCache(images)
    data = all_photos(images, 5.0, cache)
    config = TrainConfig(
        steps=args.steps,
        sh_start=3,
        mechanisms=(DensityControl(start=10, until=args.steps, every=10),) if densify else (),
    )
    count = args.gaussians // 2 if densify else args.gaussians
    trainer = Trainer(synthetic_gaussians(count), data, config)
    rows.append(("Gaussians made, trainer ready", resident()))
    trainer.train_step()
    rows.append(("after the first step", resident()))
    trainer.run()
    rows.append((f"after {trainer.step} steps", resident()))
    rows.append(("peak", resident("VmHWM")))
    print(
        f"\n{len(images)} photos of {args.size[0]} x {args.size[1]}, {args.threads} threads, "
        f"{count:,} Gaussians at first, {len(trainer.gaussians):,} at last\n"
    )
    rows += known(trainer, cache.kept_bytes)
    print("\n".join(table(["moment", "MiB"], ([name, f"{mib:.0f}"] for name, mib in rows))))


def posed(paths: Sequence[Path], width: int, height: int) -> list[PosedImage]:
    """The photos, with the poses of the synthetic scene's cameras in turn."""
    import numpy as np

    from benchmarks.synthetic import ring_camera, ring_cameras
    from roigs_engine.model.scene import PosedImage

    poses = ring_cameras().double().numpy()
    return [
        PosedImage(
            name=path.name,
            path=path,
            camera=ring_camera(width, height),
            world_to_camera=poses[k % len(poses)],
            point_indices=np.zeros(0, dtype=np.int64),
        )
        for k, path in enumerate(paths)
    ]


def known(trainer: Trainer, photo_bytes: int) -> list[tuple[str, float]]:
    """Names and MiB of the arrays with known sizes."""
    tensors = list(trainer.gaussians.tensors().values())
    parameters = sum(t.nbytes for t in tensors) / MIB
    return [
        ("of it: parameters", parameters),
        ("of it: Adam's moments", 2 * parameters),
        ("of it: photos, 8 bits", photo_bytes / MIB),
    ]


def main() -> None:
    """Write the photos, then measure the two settings."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--gaussians", type=int, default=200_000)
    parser.add_argument("--photos", type=int, default=100)
    parser.add_argument("--size", type=int, nargs=2, default=[640, 426], metavar=("W", "H"))
    parser.add_argument("--steps", type=int, default=120)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--train", type=Path, metavar="FOLDER", help=argparse.SUPPRESS)
    parser.add_argument("--densify", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.train is not None:
        train(args.train, args, args.densify)
        return
    with tempfile.TemporaryDirectory() as folder:
        write_photos(Path(folder), args.photos, *args.size)
        again = [sys.executable, "-m", "benchmarks.memory", *sys.argv[1:], "--train", folder]
        for setting in ([], ["--densify"]):
            subprocess.run([*again, *setting], check=True)


if __name__ == "__main__":
    main()
