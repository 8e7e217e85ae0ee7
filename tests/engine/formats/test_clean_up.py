"""A run folder loses what can be made again, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from roigs_engine.cli import main
from roigs_engine.formats import clean_up
from roigs_engine.formats.stage_list import write_stage_list
from tests.engine.commands.command_line import refused
from tests.engine.other_process import in_the_middle

GONE = (
    *(f"cache/undistorted/{1:032x}.png", f"cache/masks/{2:032x}.png", "preview.ply"),
    *("stages/scene-12345678/model.ply", "stages/joint-12345678/checkpoint.bin"),
    "stages/joint-abcdefab-damaged/stage.json",
)
HOLD = """
import sys
from pathlib import Path
from roigs_engine.formats.lock import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""
KEPT = (
    *("cache/undistorted/mine.png", "stages/mine/model.ply", "stages/scene-12345678/notes.txt"),
    *("archive/mine.ply", "stages/notes.txt"),
    *("manifest.json", "result.ply", "rois/a.ply", "coarse/a.ply"),
    *("stages.json", "stages/scene-abcdefab/model.ply"),
    *("cache/photos.json", "earlier/12345678/result.ply", "renders/1.png"),
    *("stages/joint-abcdefab/checkpoint.bin", "blender/train.json", "compare-joint/result.ply"),
)


def files(folder: Path) -> set[str]:
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture
def run(tmp_path: Path) -> Path:
    for name in (*GONE, *KEPT):
        path = tmp_path / "run" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(1000))
    run = tmp_path / "run"
    (run / "manifest.json").write_text('{"version": 1, "config": {}}', encoding="utf-8")
    write_stage_list(
        run, {name: run / "stages" / f"{name}-abcdefab" for name in ("scene", "joint")}
    )
    return run


def test_what_can_be_made_again_goes(run: Path) -> None:
    assert clean_up.disk_size(clean_up.removable(run)) == 1000 * len(GONE)
    assert clean_up.remove(run) == 1000 * len(GONE)
    assert files(run) == set(KEPT)
    assert clean_up.remove(run) == 0


def test_the_command_says_what_it_removes(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["clean", str(run), "--dry-run"]) == 0
    assert "stages/scene-12345678" in capsys.readouterr().out.replace("\\", "/")
    assert files(run) == {*GONE, *KEPT}
    assert main(["clean", str(run)]) == 0
    assert "Removed 1 MB" in capsys.readouterr().err
    assert files(run) == set(KEPT)
    assert main(["clean", str(run)]) == 0
    assert "nothing to remove" in capsys.readouterr().err


def test_a_preview_without_a_result_stays(run: Path) -> None:
    (run / "result.ply").unlink()
    clean_up.remove(run)
    assert (run / "preview.ply").exists()


def test_other_folders_are_left_alone(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for text in ('{"name": "a web app"}', "{"):
        (run / "manifest.json").write_text(text, encoding="utf-8")
        assert "is not a run folder" in refused(capsys, "clean", run)
    (run / "manifest.json").unlink()
    assert "is not a run folder" in refused(capsys, "clean", run)
    assert clean_up.removable(run) == []
    assert "is not a run folder" in refused(capsys, "clean", tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_links_are_not_followed(run: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "scene-12345678").mkdir()
    (run / "stages").rename(tmp_path / "real")
    (run / "stages").symlink_to(tmp_path / "mine")
    clean_up.remove(run)
    assert (tmp_path / "mine" / "scene-12345678").is_dir()


def test_without_a_list_no_stage_goes(run: Path) -> None:
    (run / "stages.json").write_text("{", encoding="utf-8")
    assert not [path for path in clean_up.removable(run) if path.parent.name == "stages"]


def test_a_run_in_use_is_left_alone(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with in_the_middle(HOLD, run, "held"):
        line = refused(capsys, "clean", run)
    assert "at work" in line and line.endswith(". Wait for it, or stop it.")
    assert files(run) == {*GONE, *KEPT}
