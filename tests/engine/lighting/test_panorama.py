"""Panoramas of light: directions, values, holes, and what is left out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from roigs_engine.cli import main
from roigs_engine.errors import ConfigError
from roigs_engine.formats.rois import rois_document
from roigs_engine.lighting.panorama import (
    directions,
    filled,
    left_out,
    panorama,
    solid_angles,
)
from roigs_engine.model.gaussians import Gaussians
from roigs_engine.model.roi import OrientedBox
from tests.engine.clouds import affine, placed
from tests.engine.commands.command_line import refused
from tests.engine.lighting.room import GREY, RADIUS, room

cv2 = pytest.importorskip("cv2")
HEIGHT = 64
LINEAR = ((GREY + 0.055) / 1.055) ** 2.4
RED = (0.9, 0.1, 0.1)
# Where Blender's environment texture has it: row from the top, column from the left, of 1.
PLACES = {
    (1.0, 0.0, 0.0): (0.5, 0.5),
    (0.0, 1.0, 0.0): (0.5, 0.25),
    (0.0, -1.0, 0.0): (0.5, 0.75),
    (0.6, 0.0, 0.8): (0.5 - np.arcsin(0.8) / np.pi, 0.5),
}


@pytest.mark.parametrize("way", PLACES)
def test_a_patch_is_in_its_pixel_in_linear_light(way: tuple[float, float, float]) -> None:
    light = panorama([placed(room({way: RED}))], np.zeros(3), HEIGHT).light
    row, column = (int(share * size) for share, size in zip(PLACES[way], light.shape, strict=False))
    assert light[row, column] == pytest.approx([0.787, 0.01, 0.01], abs=0.02)
    opposite = light[HEIGHT - 1 - row, (column + HEIGHT) % (2 * HEIGHT)]
    assert opposite == pytest.approx([LINEAR] * 3, rel=0.03)


def test_directions_are_of_all_the_sphere() -> None:
    assert solid_angles(HEIGHT).sum() * 2 * HEIGHT == pytest.approx(4 * np.pi)
    mean = (directions(HEIGHT) * solid_angles(HEIGHT)[..., None]).sum(axis=(0, 1))
    assert mean == pytest.approx(np.zeros(3), abs=1e-9)


def test_white_is_clipped_and_brightened() -> None:
    found = panorama([placed(room({(0, 0, 1): (1.0, 1.0, 1.0)}))], np.zeros(3), HEIGHT)
    assert found.clipped[0].all() and not found.clipped[HEIGHT // 2 :].any()
    bright = found.brightened(7.0, 1.0)
    assert bright[0] == pytest.approx(7.0 * found.light[0])
    assert (bright[HEIGHT // 2 :] == found.light[HEIGHT // 2 :]).all()


def test_holes_get_what_is_around_them() -> None:
    found = panorama([placed(room(hole=(0, 0, 1)))], np.zeros(3), HEIGHT)
    assert 0.85 < found.seen < 0.97
    assert found.light == pytest.approx(np.full(found.light.shape, LINEAR), rel=0.05)
    bright = found.brightened(1.0, 5.0)  # the hole alone, as it is above
    assert bright[0] == pytest.approx(5 * found.light[0], rel=0.05)
    assert np.abs(np.diff(bright[..., 0], axis=0)).max() < 2 * LINEAR  # without an edge
    assert bright[HEIGHT // 2 :] == pytest.approx(found.light[HEIGHT // 2 :])


def test_light_that_no_photo_shows_is_neutral() -> None:
    """A red room has no red lamps; mirrors go on showing red."""
    red = room(hole=(0, 0, 1))
    red.sh[:, 0, 1:] -= 1.0
    found = panorama([placed(red)], np.zeros(3), HEIGHT)
    light, mirrored = found.brightened(1.0, 2.0), found.brightened(1.0)
    assert light[0] == pytest.approx(np.full(light[0].shape, 2 * found.light[0].mean()), rel=0.05)
    assert mirrored == pytest.approx(found.light)
    assert (mirrored[0, :, 0] > 3 * mirrored[0, :, 1]).all()


def test_the_left_and_the_right_edge_meet() -> None:
    light, alpha = np.zeros((8, 16, 3), np.float32), np.zeros((8, 16), np.float32)
    light[:, 15], alpha[:, 15] = 1.0, 1.0
    light[:, 8], alpha[:, 8] = 0.0, 1.0
    whole = filled(light, alpha)
    assert (whole[:, 0] > whole[:, 7]).all()


def test_boxes_and_what_is_near_are_left_out() -> None:
    model = placed(room(), affine(2 * np.eye(3), (0.0, 0.0, 10.0)))
    above = OrientedBox.between("above", [-5.0, -5, 0], [5.0, 5, 5])
    lower = left_out(model, [above], np.zeros(3), 0.0).gaussians.means
    assert lower[:, 2].max() < 0 and len(lower) > 1000
    place = np.array([0.0, 0, 10 + 2 * RADIUS])  # on the sphere, in the world
    far = left_out(model, [], place, RADIUS).gaussians.means.numpy()
    away = np.linalg.norm(2 * far + [0, 0, 10] - place, axis=1)
    assert away.min() >= RADIUS and len(far) < len(model.gaussians)


def test_an_empty_picture_is_refused() -> None:
    lonely = room().rows(room().means[:, 2] > 3.99)
    faint = lonely.with_tensors({"logit_opacities": lonely.logit_opacities * 0 - 5})
    with pytest.raises(ConfigError, match="Nothing is visible"):
        panorama([placed(faint)], np.zeros(3), HEIGHT)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run folder with a room, a red box in it, and nothing else."""
    room({(1, 0, 0): RED}).save_ply(tmp_path / "result.ply")
    box = OrientedBox.between("red", [3.0, -2, -2], [5.0, 2, 2])
    (tmp_path / "manifest.json").write_text(rois_document([box]))
    return tmp_path


def test_the_command_writes_a_file_for_each_point(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["panorama", str(run / "result.ply"), "--width", "128", "--device", "cpu"]
    assert main([*words, "--at", "0,0,0", "--out", str(run / "one.hdr")]) == 0
    one = cv2.imread(str(run / "one.hdr"), cv2.IMREAD_UNCHANGED)
    assert one.shape == (64, 128, 3)
    assert one[32, 64] == pytest.approx([0.01, 0.01, 0.787], abs=0.02)  # OpenCV has blue first
    whole = room({})
    whole.rows(torch.nonzero(whole.means[:, 2] < 0)[:, 0]).save_ply(run / "low.ply")
    brighter = ["--at", "0,0,0", "--unseen", "5", "--out", str(run / "five.hdr")]
    assert main(["panorama", str(run / "low.ply"), *words[2:], *brighter]) == 0
    five, mirror = (
        cv2.imread(str(run / f"five{end}.hdr"), cv2.IMREAD_UNCHANGED).sum()
        for end in ("", "-mirror")
    )
    assert five > 1.5 * mirror  # what is only guessed is not mirrored brighter
    (run / "six-mirror.hdr").write_text("mine")
    capsys.readouterr()
    assert main([*words, "--at", "0,0,0", "--out", str(run / "six.hdr")]) == 2
    assert "needs six-mirror.hdr beside it, which would be" in capsys.readouterr().err
    assert (run / "six-mirror.hdr").read_text() == "mine" and not (run / "six.hdr").exists()
    (run / "six.hdr").write_bytes((run / "five.hdr").read_bytes())  # is no reason to replace both
    assert main([*words, "--at", "0,0,0", "--out", str(run / "six.hdr")]) == 2
    assert (run / "six-mirror.hdr").read_text() == "mine"
    assert main([*words, "--at", "0,0,0", "--out", str(run / "five.hdr")]) == 0
    capsys.readouterr()
    more = ["--at", "0,0,0", "--at=-1,0,0", "--without", "red", "--out", str(run / "two.hdr")]
    assert main([*words, *more]) == 0
    assert capsys.readouterr().out.count("Light at ") == 2
    for k in (1, 2):
        grey = cv2.imread(str(run / f"two-{k}.hdr"), cv2.IMREAD_UNCHANGED)
        assert grey[32, 64] == pytest.approx([LINEAR] * 3, rel=0.05)


def test_boxes_of_a_run_cut_nothing_from_models_of_others(run: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    model = Gaussians.load_ply(run / "result.ply")
    model.save_ply(other / "result.ply")
    listed = run / "list.json"
    words = ["panorama", str(listed), "--width", "128", "--device", "cpu", "--at", "0,0,0"]
    reds = []
    for name in ("other/result.ply", "result.ply"):
        same = np.eye(4).tolist()
        listed.write_text(json.dumps({"models": [{"ply": str(tmp_path / name), "matrix": same}]}))
        out = tmp_path / f"{len(reds)}.hdr"
        assert main([*words, "--run", str(run), "--without", "red", "--out", str(out)]) == 0
        light = cv2.imread(str(out), cv2.IMREAD_UNCHANGED)
        reds.append(float((light[..., 2] - light[..., 0]).max()))
    assert reds[0] > 0.5 > 10 * reds[1]


WRONG = {
    "box": (["--without", "blue"], "has no box 'blue'"),
    "place": (["--at", "0,0"], "is not a point"),
    "ending": (["--out", "light.png"], "is no .hdr file"),
    "factor": (["--highlights", "0.5"], "is not a number from 1"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_said_in_a_line(
    run: Path, capsys: pytest.CaptureFixture[str], what: str
) -> None:
    options, message = WRONG[what]
    out = [] if "--out" in options else ["--out", str(run / "one.hdr")]
    place = [] if "--at" in options else ["--at", "0,0,0"]
    assert message in refused(capsys, "panorama", run / "result.ply", *place, *out, *options)
