"""The page of a batch, of run folders that others may have written."""

from __future__ import annotations

import json
import os
import struct
import zlib
from pathlib import Path
from typing import Any

import pytest

from roigs_engine.batch.engine_process import DONE
from roigs_engine.batch.page import write_batch_page
from roigs_engine.batch.parts import ScenePlan
from roigs_engine.batch.schedule import SceneState
from roigs_engine.formats.report_scores import scores_of_result
from tests.fuzz.damage import ODD_VALUES

ROW = {"roi_psnr": 31.5, "roi_ssim": 0.9, "gaussians_in_box": 1200, "seconds": 90.0}
HUGE = 10**400


def page(folder: Path, rois: Any) -> str:
    """The page of a batch with one finished scene, whose report has these boxes."""
    run = folder / "hall"
    run.mkdir(exist_ok=True)
    (run / "report.json").write_text(json.dumps({"rois": rois}), encoding="utf-8")
    plan = ScenePlan(name="hall", objects=("vase",), steps=(), parts=(), done=True)
    scene = SceneState(plan=plan, parts={})
    assert scene.state == DONE
    return write_batch_page(folder, [scene]).read_text(encoding="utf-8")


def test_the_scores_of_the_result(tmp_path: Path) -> None:
    found = page(tmp_path, [{"roi": "vase", "rows": [{"roi_psnr": 1.0}, ROW]}])
    assert "31.50" in found and "1,200" in found
    assert scores_of_result(tmp_path / "hall") == {"vase": ROW}


@pytest.mark.parametrize("odd", [*ODD_VALUES, HUGE, -HUGE, float("nan"), 1e308])
def test_damaged_scores_are_left_out(tmp_path: Path, odd: Any) -> None:
    """One run's report must not end the batch of all."""
    page(tmp_path, odd)
    for rois in (odd, {"roi": "vase", "rows": odd}, {"roi": "vase", "rows": [odd]}):
        page(tmp_path, [rois])
    page(tmp_path, [{"roi": odd, "rows": [ROW]}])
    for name in ROW:
        found = page(tmp_path, [{"roi": "vase", "rows": [ROW | {name: odd}]}])
        assert name == "gaussians_in_box" or "1,200" in found


def picture(width: int, height: int) -> bytes:
    """A PNG that says it is so large."""
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = (b"IHDR" + head, b"IDAT" + zlib.compress(b""), b"IEND")
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(part) - 4) + part + struct.pack(">I", zlib.crc32(part))
        for part in parts
    )


@pytest.mark.parametrize("side", [0, 10, 10_000, 30_000])
@pytest.mark.filterwarnings("error")
def test_damaged_pictures_are_left_out(tmp_path: Path, side: int) -> None:
    shown = tmp_path / "hall" / "crops" / "vase" / "overview.png"
    shown.parent.mkdir(parents=True)
    shown.write_bytes(picture(side, side))
    assert "<img" not in page(tmp_path, [])


@pytest.mark.skipif(os.name != "posix", reason="makes a pipe")
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    shown = tmp_path / "hall" / "crops" / "vase" / "overview.png"
    shown.parent.mkdir(parents=True)
    os.mkfifo(shown)
    assert "<img" not in page(tmp_path, [])
