"""Measures the rows that a study lacks, the most important first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.study.measure import Bench
from benchmarks.study.rows import Row
from benchmarks.study.scenes import StudyScene
from roigs_engine.colmap.exposures import with_exposures
from roigs_engine.colmap.project import load_colmap
from roigs_engine.context import QUIET, Context
from roigs_engine.errors import EngineError
from roigs_engine.formats.files import read_json, write_json
from roigs_engine.formats.lock import locked
from roigs_engine.formats.names import safe_name
from roigs_engine.formats.text import json_digest
from roigs_engine.model.scene import SfmScene

Item = tuple[StudyScene, int, Row]


def in_order(rows: Sequence[Row], scenes: Sequence[StudyScene], seeds: Sequence[int]) -> list[Item]:
    """Every row of every scene and seed, what matters most first.

    The main rows of the first seed in all scenes; then those of the second and the next rows of the
    first; and so on along the diagonals.
    """
    items = [
        (row.rank + turn, row.rank, scene_at, row_at)
        for turn in range(len(seeds))
        for scene_at in range(len(scenes))
        for row_at, row in enumerate(rows)
    ]
    return [
        (scenes[scene_at], seeds[diagonal - rank], rows[row_at])
        for diagonal, rank, scene_at, row_at in sorted(items)
    ]


@dataclass(kw_only=True)
class Work:
    """Measures the rows of a study into its folder.

    Attributes:
        folder: of the study.
        preset, factor: settings; what their steps are multiplied by.
        max_side: longest side of the photos used; None: as they are.
        evaluate_on: `test` or `validation` photos.
        keep_models: keep what only an ablation or variant needs.
        context: of the work.
    """

    folder: Path
    preset: str
    factor: float
    max_side: int | None
    evaluate_on: str
    keep_models: bool
    context: Context = QUIET
    _loaded: dict[str, SfmScene] = field(default_factory=dict)

    def do(
        self,
        rows: Sequence[Row],
        scenes: Sequence[StudyScene],
        seeds: Sequence[int],
        after_each: Callable[[], None],
    ) -> list[str]:
        """Measure what is missing; one line for each row that failed, which stops no other row.

        Raises:
            Stopped: on request; the same call resumes later.
        """
        items, failures = in_order(rows, scenes, seeds), []
        for number, (scene, seed, row) in enumerate(items, start=1):
            self.context.check_cancelled()
            title = f"{scene.name}, seed {seed}, {row.name}"
            try:
                if self._measure(scene, seed, row, f"[{number}/{len(items)}] {title}"):
                    after_each()
            except EngineError as error:
                failures.append(f"{title}: {error}")
                self.context.warn(failures[-1])
        return failures

    def _measure(self, scene: StudyScene, seed: int, row: Row, title: str) -> bool:
        """Measure the row and write its record; False if the record was there already."""
        home = Path(safe_name(scene.name)) / f"seed-{seed}"
        path = self.folder / "rows" / home / f"{row.name}.json"
        bench = Bench(
            scene=scene,
            sfm=self._sfm(scene),
            seed=seed,
            preset=self.preset,
            factor=self.factor,
            folder=self.folder / "runs" / home,
            pictures=self.folder / "pictures" / home,
            evaluate_on=self.evaluate_on,
            context=self.context,
        )
        manifest = bench.manifest(row)
        if path.exists() and (before := read_json(path).get("manifest")) != manifest:
            _move(path, _earlier(path, before))
            self.context.warn(
                f"{title}: settings, photos or boxes have changed; the earlier record is in"
                " earlier/."
            )
        if not path.exists() and _earlier(path, manifest).exists():
            _move(_earlier(path, manifest), path)
        if path.exists():
            return False
        self.context.info(title)
        with locked(bench.folder):
            write_json(path, bench.measure(row, keep_models=self.keep_models))
        return True

    def _sfm(self, scene: StudyScene) -> SfmScene:
        if scene.name not in self._loaded:
            cache = self.folder / "cache" / safe_name(scene.name)
            loaded = load_colmap(
                scene.path, cache=cache, max_side=self.max_side, context=self.context
            )
            levelled = with_exposures(loaded, cache, pixels=True, context=self.context)
            self._loaded[scene.name] = levelled  # as training does
        return self._loaded[scene.name]


def _earlier(path: Path, manifest: Any) -> Path:
    """Path of a record of an earlier manifest."""
    return path.parent / "earlier" / f"{path.stem}-{json_digest(manifest)[:8]}.json"


def _move(source: Path, target: Path) -> None:
    target.parent.mkdir(exist_ok=True)
    source.replace(target)
