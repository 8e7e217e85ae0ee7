"""Cost and gain of levels of detail: `python -m benchmarks.levels RUN SCENE --out DIR`.

RUN is a run folder after `levels RUN`. Three figures, each on views that no level was trained on:

- far: the run's test photos, drawn smaller and smaller, as from farther away. The result as it is,
  and in levels, against the photos at that size.
- alone: each box's object alone before grey, the cameras of the test photos moved back from it,
  pictures of full size. The level against the whole object drawn without aliasing, and as it is.
- fly-in: 120 frames of a zoom from 8 times to the photo's own distance, at some test photos. The
  largest mean change of a pixel between two frames: in levels, and of the result as it is.

Writes `levels.md`, `levels.csv`, and, with matplotlib (the extra `study`), `levels.png`.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from roigs_engine.colmap.project import load_colmap
from roigs_engine.evaluation.metrics import psnr_from_mse
from roigs_engine.formats.files import read_json
from roigs_engine.formats.levels import Ladder, read_ladders, shown_levels
from roigs_engine.levels.parts import LevelledResult, rate_of, small_picture
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.model.scene import Camera, Float64, PosedImage
from roigs_engine.photos.decode import load_photo
from roigs_engine.rasterize.view import RenderedView, render_view

TIMES = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
FRAMES, FLIGHTS, FROM = 120, 3, 8.0
SAMPLES = 4
GREY = 0.5


@dataclass(frozen=True, kw_only=True)
class Far:
    """Means over test photos drawn `times` times smaller; PSNR in dB, CPU time in ms."""

    times: float
    photo_whole: float
    photo_levels: float
    smooth_whole: float
    smooth_levels: float
    whole_levels: float
    gaussians: float
    share: float
    ms_whole: float
    ms_levels: float


def far(run: Path, photos: Sequence[PosedImage], frame: LocalFrame, times: float) -> Far:
    """Measure the scene as from `times` the distance, with smaller pictures."""
    whole, levels = Gaussians.load_ply(run / "result.ply", frame), LevelledResult(run, frame)
    rows = []
    for image in photos:
        small = image.scaled(1 / times)
        camera, pose = small.camera, image.world_to_camera
        photo = torch.from_numpy(load_photo(small)).float() / 255
        needed = levels.gaussians(camera, pose)
        plain, plain_ms = timed(partial(render_view, whole, camera, pose))
        drawn, drawn_ms = timed(partial(render_view, needed, camera, pose))
        smooth = small_picture(whole, (camera, pose), SAMPLES, 0.0)
        pairs = ((plain, photo), (drawn, photo), (plain, smooth), (drawn, smooth), (drawn, plain))
        errors = [float(((a - b) ** 2).mean()) for a, b in pairs]
        rows.append([*map(psnr_from_mse, errors), len(needed), plain_ms, drawn_ms])
    mean = np.mean(rows, axis=0).tolist()
    return Far(
        times=times,
        photo_whole=mean[0],
        photo_levels=mean[1],
        smooth_whole=mean[2],
        smooth_levels=mean[3],
        whole_levels=mean[4],
        gaussians=mean[5],
        share=mean[5] / len(whole),
        ms_whole=float(np.median([row[6] for row in rows])),
        ms_levels=float(np.median([row[7] for row in rows])),
    )


def timed(draw: Callable[[], RenderedView]) -> tuple[Tensor, float]:
    """Render twice; returns the picture, and the CPU time of the second call, ms."""
    draw()
    began = time.process_time()
    picture = draw().image
    return picture, 1000 * (time.process_time() - began)


def alone(
    run: Path, ladder: Ladder, photos: Sequence[PosedImage], frame: LocalFrame, times: float
) -> list[float] | None:
    """Share of Gaussians drawn, and three PSNRs of whole pictures; None: no photo shows the part.

    The PSNRs compare the level with the smooth whole, the level with the plain whole, and the plain
    whole with the smooth whole.
    """
    files = {level.ply: Gaussians.load_ply(run / level.ply, frame) for level in ladder.levels}
    whole = files[ladder.levels[0].ply]
    probes = frame.points(ladder.probes)
    middle, rows = probes.mean(axis=0), []
    for image in photos:
        if rate_of(probes, (image.camera, image.world_to_camera)) == 0:
            continue
        near = ladder.rate / frame.scale
        at = rate_of(probes, (image.camera, image.world_to_camera))
        pose = moved_back(image.world_to_camera, image.centre, middle, times * at / near)
        view = (image.camera, pose)
        (level, _), *_ = shown_levels(ladder, rate_of(probes, view) * frame.scale)[::-1]
        smooth = small_picture(whole, view, SAMPLES, GREY)
        plain, drawn = (small_picture(g, view, 1, GREY) for g in (whole, files[level.ply]))
        pairs = ((drawn, smooth), (drawn, plain), (plain, smooth))
        errors = [float(((a - b) ** 2).mean()) for a, b in pairs]
        rows.append([len(files[level.ply]) / len(whole), *map(psnr_from_mse, errors)])
    return np.mean(rows, axis=0).tolist() if rows else None


def moved_back(pose: Float64, centre: Float64, middle: Float64, times: float) -> Float64:
    """The world_to_camera of a camera moved to `times` its distance from `middle`."""
    moved = pose.copy()
    moved[:3, 3] = -moved[:3, :3] @ (middle + times * (centre - middle))
    return moved


def fly_in(run: Path, image: PosedImage, frame: LocalFrame) -> tuple[float, float]:
    """The largest mean change between two frames: of the whole result, and with levels."""
    whole, levels = Gaussians.load_ply(run / "result.ply", frame), LevelledResult(run, frame)
    before: list[Tensor] = []
    changes: list[list[float]] = []
    for times in np.geomspace(FROM, 1, FRAMES):
        camera = zoomed(image.camera, float(times))
        models = (whole, levels.gaussians(camera, image.world_to_camera))
        now = [render_view(model, camera, image.world_to_camera).image for model in models]
        if before:
            changes.append([float((a - b).abs().mean()) for a, b in zip(now, before, strict=True)])
        before = now
    plain, drawn = np.max(changes, axis=0).tolist()
    return plain, drawn


def zoomed(camera: Camera, times: float) -> Camera:
    """The camera with 1 / `times` of its focal length, for pictures of half the size."""
    half = camera.resized(camera.width // 2, camera.height // 2)
    values = {**asdict(half), "fx": 2 * half.fx / times, "fy": 2 * half.fy / times}
    return Camera(**values)


def report(run: Path, scene: Path, out: Path) -> str:
    """Measure everything, write the files, and return the tables."""
    split = read_json(run / "split.json")
    loaded = load_colmap(
        scene,
        cache=out / "cache",
        max_side=max(map(int, "x".join(read_json(run / "manifest.json")["sizes"]).split("x"))),
    )
    frame = LocalFrame.of_scene(loaded)
    wanted = set(split[split.get("evaluate_on", "test")])
    photos = [image for image in frame.scene(loaded).images if image.name in wanted]
    rows = [far(run, photos, frame, times) for times in TIMES]
    lines = [
        "| distance | Gaussians drawn | photo: whole | photo: levels | smooth: whole"
        " | smooth: levels | levels to whole | ms whole | ms levels |",
        "|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {r.times:g} | {100 * r.share:.0f} % | {r.photo_whole:.2f} | {r.photo_levels:.2f}"
        f" | {r.smooth_whole:.2f} | {r.smooth_levels:.2f} | {r.whole_levels:.2f}"
        f" | {r.ms_whole:.0f} | {r.ms_levels:.0f} |"
        for r in rows
    ]
    lines += ["", "| alone, 4 x | drawn | to smooth | to whole | whole to smooth |"]
    lines += ["|---|---:|---:|---:|---:|"]
    for ladder in read_ladders(run).values():
        found = alone(run, ladder, photos, frame, 4.0) if ladder.box else None
        if found:
            share, *psnr = found
            cells = " | ".join(f"{value:.1f}" for value in psnr)
            lines.append(f"| {ladder.box} | {100 * share:.0f} % | {cells} |")
    lines += ["", "| fly-in | whole | levels |", "|---|---:|---:|"]
    for image in photos[:: max(1, len(photos) // FLIGHTS)][:FLIGHTS]:
        plain, drawn = fly_in(run, image, frame)
        lines.append(f"| {image.name} | {100 * plain:.2f} % | {100 * drawn:.2f} % |")
    text = "\n".join(lines) + "\n"
    out.mkdir(parents=True, exist_ok=True)
    (out / "levels.md").write_text(text, encoding="utf-8")
    with open(out / "levels.csv", "w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, list(asdict(rows[0])))
        table.writeheader()
        table.writerows(asdict(row) for row in rows)
    draw(rows, out / "levels.png")
    return text


def draw(rows: Sequence[Far], path: Path) -> None:
    """Plot PSNR and number of Gaussians against distance, if matplotlib is installed."""
    try:
        import matplotlib
    except ImportError:
        return
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 4))
    times = [row.times for row in rows]
    axes.plot(times, [row.photo_whole for row in rows], "o-", color="#bbbbbb", label="whole")
    axes.plot(times, [row.photo_levels for row in rows], "o-", color="#ee6677", label="levels")
    axes.set_xscale("log", base=2)
    axes.set_xlabel("distance, in those of the photos")
    axes.set_ylabel("PSNR against test photos, dB")
    axes.legend(loc="lower left")
    other = axes.twinx()
    other.plot(times, [100 * row.share for row in rows], "--", color="#4477aa")
    other.set_ylabel("Gaussians drawn, %", color="#4477aa")
    other.set_ylim(0, 105)
    figure.tight_layout()
    figure.savefig(path, dpi=120)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split(":")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    print(report(args.run, args.scene, args.out))


if __name__ == "__main__":
    main()
