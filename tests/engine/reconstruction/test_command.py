"""`reconstruct` as a process: its events, its signals, and what it refuses."""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.engine.commands.command_line import refused, start
from tests.engine.reconstruction.photo_sets import copy_photos, demo_photos
from tests.machine_load import Waited

pytest.importorskip("pycolmap")


@pytest.mark.skipif(sys.platform == "win32", reason="has no such signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_pycolmap_stops_within_two_seconds(tmp_path: Path, number: int) -> None:
    photos = demo_photos("wide/*.jpg", 6)
    copy_photos(tmp_path / "photos", photos, [path.name for path in photos])
    with start(
        *("reconstruct", tmp_path / "photos", "--out", tmp_path / "scene", "--events"),
        *("--threads", 1),
    ) as process:
        assert process.stdout is not None
        record: dict[str, Any] = {}
        while record.get("event") != "progress" or record["stage"] != "features":
            record = json.loads(process.stdout.readline())
        waited = Waited()
        process.send_signal(number)
        last = json.loads(process.stdout.read().splitlines()[-1])
        assert process.wait(60) == 3
        assert waited.at_most(2)
    assert last == {"event": "done", "outputs": {}, "stopped": True}


def test_what_cannot_be_used_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ("--out", tmp_path / "scene")
    assert "is not a folder" in refused(capsys, "reconstruct", tmp_path / "none", *out)
    (tmp_path / "empty").mkdir()
    assert "has no photos" in refused(capsys, "reconstruct", tmp_path / "empty", *out)
    masks = ("--masks", tmp_path / "none")
    assert "is not a folder" in refused(capsys, "reconstruct", tmp_path / "empty", *out, *masks)
    assert not (tmp_path / "scene").exists()
