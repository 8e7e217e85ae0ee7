"""Streamed SOG: a model in levels of detail, as PlayCanvas loads it."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from roigs_engine.cli import main
from roigs_engine.exchange import formats, streamed_sog
from roigs_engine.formats.levels import Ladder, Level, write_ladders
from roigs_engine.formats.splat_ply import write_ply
from tests.engine.commands.command_line import refused
from tests.engine.exchange.test_foreign import read_by
from tests.engine.exchange.test_formats import arrays

OCTREE = """\
const [folder, file] = process.argv.slice(1);
const source = folder + '/playcanvas/build/playcanvas/src/';
const { GSplatOctree } = await import(source + 'scene/gsplat-unified/gsplat-octree.js');
const data = JSON.parse((await import('node:fs')).readFileSync(file));
const octree = new GSplatOctree('scene/lod-meta.json', data);
const counts = octree.nodes.map((node) => node.lods.map((lod) => lod.count));
const bounds = Array.from(octree.nodeBoundsMinMax);
process.stdout.write(JSON.stringify({ counts: counts.flat(), bounds }), () => process.exit(0));
"""


def test_a_part_has_its_levels_its_bounds_and_a_sog_for_each(tmp_path: Path) -> None:
    for name in ("sklearn", "gsply"):
        pytest.importorskip(name)
    parts = [[arrays(600), arrays(300)], [arrays(400)]]
    path = tmp_path / "scene/lod-meta.json"
    assert streamed_sog.write(path, parts) == 1000
    meta = json.loads(path.read_text())
    assert meta["lodLevels"] == 2 and meta["counts"] == [1000, 300] and meta["count"] == 1300
    for node, part in zip(meta["tree"]["children"], parts, strict=True):
        low, high = (np.array(node["bound"][end]) for end in ("min", "max"))
        assert len(node["lods"]) == len(part)
        for level, wanted in enumerate(part):
            lod = node["lods"][str(level)]
            assert lod["count"] == len(wanted["means"]) and lod["offset"] == 0
            assert (wanted["means"] >= low).all() and (wanted["means"] <= high).all()
            folder = (path.parent / meta["filenames"][lod["file"]]).parent
            packed = tmp_path / "one.sog"
            with zipfile.ZipFile(packed, "w") as file:
                for item in folder.iterdir():
                    file.write(item, item.name)
            found = formats.read(packed)["means"]
            span = np.ptp(wanted["means"], axis=0).max()
            near = np.sort(found, axis=0) - np.sort(wanted["means"], axis=0)
            assert np.abs(near).max() < 2e-4 * span


def test_playcanvas_reads_it(tmp_path: Path) -> None:
    path = tmp_path / "lod-meta.json"
    streamed_sog.write(path, [[arrays(600), arrays(300)], [arrays(400)]])
    needed = "build/playcanvas/src/scene/gsplat-unified/gsplat-octree.js"
    found = read_by("playcanvas", needed, OCTREE, path)
    assert found["counts"].tolist() == [600, 300, 400, 0]
    assert len(found["bounds"]) == 12


def test_a_run_is_converted_with_its_levels(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, out = tmp_path / "run", tmp_path / "out/lod-meta.json"
    for name, count in (("result.ply", 500), ("background.ply", 500), ("levels/1/b.ply", 200)):
        (run / name).parent.mkdir(parents=True, exist_ok=True)
        write_ply(run / name, arrays(count))
    line = ["convert", str(run / "result.ply"), str(out)]
    assert "has no levels of detail" in refused(capsys, *line)
    names = ("background.ply", 0.0), ("levels/1/b.ply", 2.0)
    levels = tuple(Level(ply=p, gaussians=1, farther=f, measured={}) for p, f in names)
    write_ladders(run, [Ladder(box="", rate=1.0, probes=np.zeros((1, 3)), levels=levels)], {})
    assert "Leave out the boxes" in refused(capsys, *line, "--roi", "a=0,0,0,1,1,1")
    assert main([*line, "--sh-degree", "0"]) == 0
    assert json.loads(out.read_text())["counts"] == [500, 200]
    meta = json.loads((out.parent / "0_0/meta.json").read_text())
    assert "shN" not in meta and "model" not in meta
    write_ply(run / "background.ply", arrays(500), antialiased=True)
    capsys.readouterr()
    assert "levels/1/b.ply without" in refused(capsys, *line)
    write_ply(run / "levels/1/b.ply", arrays(200), antialiased=True)
    assert main(line) == 0
    for name in ("0_0", "1_0"):
        meta = json.loads((out.parent / name / "meta.json").read_text())
        assert meta["model"] == "antialiased"
