"""What is missing of a study, in an order in which a study cut short is still of use."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.study.measure import Bench
from benchmarks.study.rows import Row
from benchmarks.study.scenes import StudyScene
from roigs_engine.colmap.project import load_colmap
from roigs_engine.commands.console import Console
from roigs_engine.errors import EngineError
from roigs_engine.formats.events import Message
from roigs_engine.formats.files import read_json, write_json
from roigs_engine.formats.lock import locked
from roigs_engine.formats.names import safe_name
from roigs_engine.model.scene import SfmScene
from roigs_engine.run.archive import archive, restore

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
        keep_models: keep what only an ablation or variant needs.
        console: takes events, knows whether to stop.
    """

    folder: Path
    preset: str
    factor: float
    max_side: int | None
    keep_models: bool
    console: Console
    _loaded: dict[str, SfmScene] = field(default_factory=dict)

    def do(
        self,
        rows: Sequence[Row],
        scenes: Sequence[StudyScene],
        seeds: Sequence[int],
        after_each: Callable[[], None],
    ) -> list[str]:
        """Measure what is missing; what failed, one line each. The other rows are still measured.

        Raises:
            Stopped: somebody asked to; what was begun goes on where it was.
        """
        items, failures = in_order(rows, scenes, seeds), []
        for number, (scene, seed, row) in enumerate(items, start=1):
            self.console.check()
            title = f"{scene.name}, seed {seed}, {row.name}"
            try:
                if self._measure(scene, seed, row, f"[{number}/{len(items)}] {title}"):
                    after_each()
            except EngineError as error:
                failures.append(f"{title}: {error}")
                self.console.emit(Message(text=failures[-1], level="warning"))
        return failures

    def _measure(self, scene: StudyScene, seed: int, row: Row, title: str) -> bool:
        """Write the row's record, unless it is there; whether it was not."""
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
            console=self.console,
        )
        request = bench.request(row)
        if path.exists() and (before := read_json(path).get("request")) != request:
            archive(path, _digest(before))
            text = f"{title}: settings, photos or boxes have changed; the earlier one is in older/."
            self.console.emit(Message(text=text, level="warning"))
        restore(path, _digest(request))
        if path.exists():
            return False
        self.console.emit(Message(text=title))
        with locked(bench.folder):
            write_json(path, bench.measure(row, keep_models=self.keep_models))
        return True

    def _sfm(self, scene: StudyScene) -> SfmScene:
        if scene.name not in self._loaded:
            self._loaded[scene.name] = load_colmap(
                scene.path,
                cache=self.folder / "cache" / safe_name(scene.name),
                max_side=self.max_side,
                emit=self.console.emit,
                check=self.console.check,
            )
        return self._loaded[scene.name]


def _digest(request: Any) -> str:
    return hashlib.sha256(json.dumps(request, sort_keys=True).encode()).hexdigest()
