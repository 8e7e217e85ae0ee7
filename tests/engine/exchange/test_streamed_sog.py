"""Streamed SOG: a model in levels of detail, as PlayCanvas loads it."""

from __future__ import annotations

import json
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roigs_engine.cli import main
from roigs_engine.errors import EngineError, Stopped
from roigs_engine.exchange import formats, streamed_sog
from roigs_engine.formats.levels import Ladder, Level, write_ladders
from roigs_engine.formats.lock import locked
from roigs_engine.formats.splat_ply import write_ply
from roigs_engine.formats.targets import VIEWERS
from tests.engine.commands.command_line import refused
from tests.engine.exchange.format_cases import arrays, read_by
from tests.engine.exchange.small_sogs import small, written
from tests.engine.killing import killed_everywhere, tree

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


def test_levels_that_need_more_than_the_memory_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A list of levels may name one file any number of times."""
    monkeypatch.setattr("roigs_engine.app.instances.machine_memory", lambda: 10_000_000)
    run = tmp_path / "run"
    for name in ("result.ply", "background.ply"):
        run.mkdir(exist_ok=True)
        write_ply(run / name, arrays(500))
    levels = tuple(
        Level(ply="background.ply", gaussians=1, farther=2.0**k if k else 0.0, measured={})
        for k in range(90)
    )
    write_ladders(run, [Ladder(box="", rate=1.0, probes=np.zeros((1, 3)), levels=levels)])
    line = ["convert", str(run / "result.ply"), str(tmp_path / "out/lod-meta.json")]
    assert "90 levels of detail" in refused(capsys, *line)


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
    write_ladders(run, [Ladder(box="", rate=1.0, probes=np.zeros((1, 3)), levels=levels)])
    assert "Leave out the boxes" in refused(capsys, *line, "--roi", "a=0,0,0,1,1,1")
    assert main([*line, "--sh-degree", "0"]) == 0
    assert json.loads(out.read_text())["counts"] == [500, 200]
    (meta,) = sogs(out)[:1]
    assert "shN" not in meta and "model" not in meta
    write_ply(run / "background.ply", arrays(500), target=VIEWERS)
    capsys.readouterr()
    assert "levels/1/b.ply for Viewers without" in refused(capsys, *line)
    write_ply(run / "levels/1/b.ply", arrays(200), target=VIEWERS)
    assert main(line) == 0
    assert [meta["model"] for meta in sogs(out)] == ["antialiased"] * 2
    assert len(list(out.parent.iterdir())) == 3, "folders of the first time are gone"


def sogs(path: Path) -> list[Any]:
    """The `meta.json` of each SOG that a `lod-meta.json` names."""
    names = json.loads(path.read_text())["filenames"]
    return [json.loads((path.parent / name).read_text()) for name in names]


# --- a model in the place of another ---

OLD, NEW = ([[arrays(size)], [arrays(size // 2)]] for size in (60, 40))


def refuse_mixed(path: Path) -> None:
    """Raise unless each SOG is whole and has as many Gaussians as `lod-meta.json` says."""
    record = json.loads(path.read_text())
    for node in record["tree"]["children"]:
        for lod in node["lods"].values():
            folder = (path.parent / record["filenames"][lod["file"]]).parent
            assert json.loads((folder / "meta.json").read_text())["count"] == lod["count"]
            assert (folder / "sh0.webp").read_bytes() == b"%d" % lod["count"]


@pytest.mark.parametrize("step", [7, pytest.param(1, marks=pytest.mark.slow)])
def test_killed_before_any_change_it_shows_the_old_model_or_the_new_one(
    step: int, tmp_path: Path
) -> None:
    start, fresh, out = (tmp_path / name for name in ("start", "fresh", "out"))
    written(start / "lod-meta.json", OLD)
    written(fresh / "lod-meta.json", NEW)
    path = out / "lod-meta.json"
    for number in killed_everywhere(start, out, partial(written, path, NEW), step=step):
        refuse_mixed(path)
        written(path, NEW)
        assert tree(out) == tree(fresh), f"killed before change {number}"
    assert number > 15 and not list(out.rglob("*.part"))


def test_stopped_it_leaves_the_old_model_and_nothing_else(tmp_path: Path) -> None:
    path, left = tmp_path / "lod-meta.json", iter("yn")

    def stopping(*values: Any, **options: Any) -> dict[str, bytes]:
        if next(left) == "n":
            raise Stopped("at the second SOG")
        return small(*values, **options)

    written(path, OLD)
    before = tree(tmp_path)
    with pytest.raises(Stopped):
        written(path, NEW, stopping)
    assert tree(tmp_path) == before


def test_files_of_others_stay(tmp_path: Path) -> None:
    path = tmp_path / "lod-meta.json"
    written(path, OLD)
    (ours,) = tmp_path.glob("0_0-*")
    theirs = {
        "0_0/meta.json": '{"asset": {"generator": "splat-transform"}}',
        "1_2/photo.webp": "",
        "0_7/meta.json": "damaged",
        "0_8/meta.json": '{"asset": {"generator": "ROI-GS"}, "sh0": {"files": ["../0_9/a"]}}',
        "0_9/a": "",
        "env/meta.json": "{}",
        f"{ours.name}/notes.txt": "why",
    }
    for name, text in theirs.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "2023_11").mkdir()
    written(path, NEW)
    assert all((tmp_path / name).exists() for name in theirs)
    assert (tmp_path / "2023_11").is_dir()
    assert not (ours / "meta.json").exists()


def test_another_model_in_the_same_folder_stays(tmp_path: Path) -> None:
    path, other = tmp_path / "lod-meta.json", tmp_path / "first.lod-meta.json"
    written(path, OLD)
    path.rename(other)
    written(path, NEW)
    written(path, [[arrays(10)]])
    refuse_mixed(other), refuse_mixed(path)
    assert len(list(tmp_path.glob("*/meta.json"))) == 3


def test_one_process_at_a_time(tmp_path: Path) -> None:
    with locked(tmp_path, name=streamed_sog.LOCK), pytest.raises(EngineError, match="at work"):
        written(tmp_path / "lod-meta.json", NEW)
