"""Scenes in blocks: `python -m benchmarks.blocks WHOLE CUT ...`; see README.md.

Compares finished runs of one scene: WHOLE without blocks, each CUT with blocks or groups. A test
photo crosses a border if it shows much of two parts of that run. Prints a table.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.markdown import table
from roigs_engine.colmap.project import load_colmap
from roigs_engine.formats import run_files
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.local_frame import LocalFrame
from roigs_engine.model.ownership import Partition
from roigs_engine.model.roi import OrientedBox, roi_from_dict
from roigs_engine.model.scene import SfmScene
from roigs_engine.photos.decode import load_photo
from roigs_engine.rasterize.view import render_view
from roigs_engine.run.layout import lay_out
from roigs_engine.selection.cells import Views

MUCH = 0.25  # share of a photo
HEAD = (
    *("run", "blocks", "steps", "CPU s", "Gaussians", "photos across a border"),
    *("whole (dB)", "cut", "worst photo", "other photos: whole (dB)", "cut", "in boxes (dB)"),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Finished:
    """A finished run.

    Attributes:
        folder: its run folder.
        manifest: its manifest.
        scene: the scene with all photos, in the local frame.
        frame: the local frame.
        test: names of its test photos.
    """

    folder: Path
    manifest: dict[str, Any]
    scene: SfmScene
    frame: LocalFrame
    test: tuple[str, ...]

    @classmethod
    def of(cls, folder: Path) -> Finished:
        """Load the run in a folder."""
        manifest, settings, split = (
            json.loads((folder / name).read_text("utf-8"))
            for name in (run_files.MANIFEST, run_files.SETTINGS, run_files.SPLIT)
        )
        scene = load_colmap(
            Path(settings["scene"]),
            images=settings.get("images"),
            cache=folder / run_files.CACHE,
            max_side=settings.get("max_side"),
        )
        frame = LocalFrame.of_scene(scene)
        return cls(
            folder=folder,
            manifest=manifest,
            scene=frame.scene(scene),
            frame=frame,
            test=tuple(split["test"]),
        )

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self.manifest["config"].get("blocks", 1))

    def partition(self) -> Partition:
        """The owners of a result's Gaussians."""
        rois: list[OrientedBox] = [
            self.frame.box(roi_from_dict(record)) for record in self.manifest["rois"]
        ]
        groups = self.manifest.get("groups") or [[roi.name for roi in rois]]
        train = self.scene.without(set(self.test))
        layout = lay_out(train, rois, self.blocks, tuple(map(tuple, groups)))
        assert layout.cells is not None, "the run is not cut"
        return layout.cells.partition

    def psnr(self) -> dict[str, float]:
        """PSNR of the result on each test photo, dB."""
        model = Gaussians.load_ply(self.folder / run_files.RESULT, self.frame)
        found = {}
        for name in self.test:
            image = self.scene.image(name)
            photo = torch.from_numpy(load_photo(image)).float() / 255
            drawn = render_view(model, image.camera, image.world_to_camera).image
            found[name] = float(-10 * torch.log10((drawn - photo).square().mean()))
        return found

    def stages(self) -> list[dict[str, Any]]:
        """The records of the run's stages."""
        files = sorted(self.folder.glob(f"{run_files.STAGES}/*/{run_files.STAGE}"))
        return [json.loads(file.read_text("utf-8")) for file in files]

    def in_boxes(self) -> float:
        """Mean PSNR of the last model in the boxes, dB."""
        report = json.loads((self.folder / run_files.REPORT_DATA).read_text("utf-8"))
        return float(np.mean([roi["rows"][-1]["roi_psnr"] for roi in report["rois"]]))


def across(run: Finished, partition: Partition) -> set[str]:
    """Names of the test photos in which two or more cells each fill the share `MUCH`."""
    views = Views.of(run.scene.select(run.test))
    shares = views.shares(partition.owner, int(partition.owner.max()) + 1)
    pairs = zip(views.scene.images, shares, strict=True)
    return {image.name for image, share in pairs if (share >= MUCH).sum() >= 2}


def rows(whole: Finished, cuts: list[Finished]) -> Iterator[list[str]]:
    """Yield the table's row of each run."""
    before = whole.psnr()
    yield [*_cost(whole), *[""] * 6, f"{whole.in_boxes():.2f}"]
    for run in cuts:
        assert run.test == whole.test, "the runs have other test photos"
        border, now = across(run, run.partition()), run.psnr()
        cells = _cost(run)
        for names in (border, set(run.test) - border):
            if not names:
                cells += [""] * (3 if names is border else 2)
                continue
            means = [np.mean([scores[name] for name in names]) for scores in (before, now)]
            cells += [f"{means[0]:.2f}", f"{means[1] - means[0]:+.2f}"]
            if names is border:
                cells.append(f"{min(now[name] - before[name] for name in names):+.2f}")
        cells.insert(5, str(len(border)))
        yield [*cells, f"{run.in_boxes():.2f}"]


def _cost(run: Finished) -> list[str]:
    """Name, blocks, steps, CPU seconds and Gaussians of a run."""
    stages = run.stages()
    steps = sum(stage["steps"] for stage in stages)
    seconds = sum(stage["cpu_seconds"] for stage in stages)
    count = len(Gaussians.load_ply(run.folder / run_files.RESULT, run.frame))
    return [run.folder.name, str(run.blocks), f"{steps:,}", f"{seconds:.0f}", f"{count:,}"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("whole", type=Path, help="run folder of a run without blocks")
    parser.add_argument("cuts", type=Path, nargs="+", help="run folders of runs with them")
    parser.add_argument("--out", type=Path, help="write the table to this file, too")
    given = parser.parse_args()
    found = list(rows(Finished.of(given.whole), [Finished.of(path) for path in given.cuts]))
    text = "\n".join(table(HEAD, found))
    print(text, flush=True)
    if given.out:
        given.out.write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
