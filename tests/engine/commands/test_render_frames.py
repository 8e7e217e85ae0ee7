"""`render-frames`: requests in a folder, and their answers."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from roigs_engine.app.render import Models, render_frames
from roigs_engine.cli import main
from roigs_engine.context import Context
from roigs_engine.formats.events import Event, Message, Progress
from roigs_engine.formats.frame_requests import (
    colour_file,
    depth_file,
    index_file,
    share_file,
    write_nothing,
)
from roigs_engine.formats.splat_ply import read_ply, write_ply
from roigs_engine.requests.models import RenderFrames
from tests.engine.synthetic_colmap import write_project

CAMERA = {"name": "1", "width": 32, "height": 24, "fx": 30.0, "fy": 30.0, "cx": 16.0, "cy": 12.0}
POSE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "requests"
    made.mkdir()
    write_ply(
        tmp_path / "ball.ply",
        {
            "means": np.zeros((1, 3), np.float32),
            "quats": np.array([[1, 0, 0, 0]], np.float32),
            "log_scales": np.full((1, 3), np.log(0.5), np.float32),
            "logit_opacities": np.array([8], np.float32),
            "sh": np.ones((1, 1, 3), np.float32),
        },
    )
    return made


def fails(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The text on standard error when it ends with 2."""
    assert main(arguments) == 2
    return capsys.readouterr().err


def ask(folder: Path, name: str = "a", **changes: Any) -> Path:
    """Write a request; returns where its answer goes."""
    out = folder.parent / f"{name}0001"
    record: dict[str, Any] = {
        "camera": {**CAMERA, "world_to_camera": POSE},
        "models": [{"ply": str(folder.parent / "ball.ply"), "matrix": np.eye(4).tolist()}],
        "out": str(out),
    }
    (folder / f"{name}.json").write_text(json.dumps(record | changes))
    return out


def test_requests_are_answered_and_deleted(folder: Path) -> None:
    first, second = ask(folder), ask(folder, "b")
    assert main(["render-frames", str(folder), "--once"]) == 0
    assert not list(folder.iterdir())
    for out in (first, second):
        colour = np.asarray(Image.open(colour_file(out)))
        depth = np.asarray(Image.open(depth_file(out)))
        assert colour.shape == (24, 32, 4) and depth.dtype == np.float32
        assert colour[12, 16, 3] > 250 and colour[0, 0, 3] < 50
        assert depth[12, 16] == pytest.approx(4, abs=0.05)


@pytest.mark.parametrize("rotation", [0.0, float("nan"), float("inf")])
@pytest.mark.parametrize("stretch", [1.0, 2.0])
def test_what_cannot_be_drawn_is_left_out(folder: Path, rotation: float, stretch: float) -> None:
    path = folder.parent / "ball.ply"
    arrays = {name: np.repeat(a, 2, axis=0) for name, a in read_ply(path).items()}
    arrays["means"][1] = arrays["means"][0] + (1, 0, 0)
    arrays["quats"][1] = rotation
    write_ply(folder.parent / "two.ply", arrays)
    matrix = np.diag([stretch, 1.0, 1.0, 1.0]).tolist()
    answers = [
        ask(folder, name, models=[{"ply": str(folder.parent / name), "matrix": matrix}])
        for name in ("ball.ply", "two.ply")
    ]
    assert main(["render-frames", str(folder), "--once"]) == 0
    one, two = (np.asarray(Image.open(colour_file(out))).astype(int) for out in answers)
    assert one.max() > 0 and np.abs(one - two).max() <= 1


def test_what_is_left_out_is_said_once(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Not as a warning: Blender takes that for a request that was refused."""
    path = folder.parent / "ball.ply"
    arrays = {name: np.repeat(a, 3, axis=0) for name, a in read_ply(path).items()}
    arrays["quats"][1:] = 0
    write_ply(path, arrays)
    ask(folder), ask(folder, "b")
    assert main(["render-frames", str(folder), "--once"]) == 0
    said = capsys.readouterr()
    assert (said.out + said.err).count("2 of 3 Gaussians cannot be drawn") == 1
    assert "warning" not in said.out + said.err


@pytest.mark.parametrize("flat", [False, True])
def test_exact_opacities_and_sizes_are_drawn(folder: Path, flat: bool) -> None:
    """Programs write opacities of 1 and flat Gaussians as infinite logarithms.

    The picture is that of `render`.
    """
    path = folder.parent / "ball.ply"
    arrays = dict(read_ply(path))
    arrays["logit_opacities"] = np.array([np.inf], np.float32)
    if flat:
        arrays["log_scales"][:, 2] = -np.inf
    write_ply(path, arrays)
    out = ask(folder)
    assert main(["render-frames", str(folder), "--once"]) == 0
    layer = np.asarray(Image.open(colour_file(out))).astype(float)
    assert layer[12, 16, 3] > 250
    cameras = folder.parent / "path.json"
    cameras.write_text(json.dumps({"cameras": [{**CAMERA, "world_to_camera": POSE}]}))
    rendered = ["render", str(path), "--path", str(cameras), "--out", str(folder.parent / "out")]
    assert main([*rendered, "--device", "cpu"]) == 0
    usual = np.asarray(Image.open(folder.parent / "out" / "1.png")).astype(float)
    np.testing.assert_allclose(layer[..., :3] * layer[..., 3:] / 255, usual, atol=2)


def test_relative_paths_start_at_the_folder_of_the_requests(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = {"ply": "../ball.ply", "matrix": np.eye(4).tolist()}
    ask(folder, models=[model], out="../answer")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert main(["render-frames", str(folder), "--once"]) == 0
    assert colour_file(tmp_path / "answer").is_file()


def test_gains_change_the_colours(folder: Path) -> None:
    model = {"ply": str(folder.parent / "ball.ply"), "matrix": np.eye(4).tolist()}
    plain = ask(folder)
    tinted = ask(folder, "b", models=[{**model, "gains": [0.5, 1, 0]}])
    assert main(["render-frames", str(folder), "--once"]) == 0
    before, after = (np.asarray(Image.open(colour_file(out)))[12, 16] for out in (plain, tinted))
    assert before[0] > 100 and after[0] == pytest.approx(before[0] / 2, abs=1)
    assert after[1] == before[1] and after[2] == 0 and after[3] == before[3]


def test_a_density_lets_more_through(folder: Path) -> None:
    model = {"ply": str(folder.parent / "ball.ply"), "matrix": np.eye(4).tolist()}
    whole, same = ask(folder), ask(folder, "b", models=[{**model, "density": 1}])
    half = ask(folder, "c", models=[{**model, "density": 0.2512}])  # 0.2^d (1 - d) = 0.5
    assert main(["render-frames", str(folder), "--once"]) == 0
    first, second, third = (
        np.asarray(Image.open(colour_file(out))).astype(int) for out in (whole, same, half)
    )
    assert (first == second).all() and first[12, 16, 3] > 250
    assert third[12, 16, 3] == pytest.approx(first[12, 16, 3] / 2, abs=2)
    np.testing.assert_allclose(third[12, 16, :3], first[12, 16, :3], atol=2)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"camera": {}}, "'name'"),
        ({"models": []}, "no model"),
        ({"models": [{"ply": "none.ply", "matrix": np.eye(4).tolist()}]}, "none.ply ("),
        ({"models": [{"ply": "a", "matrix": np.zeros((4, 4)).tolist()}]}, "affine"),
        ({"models": [{"ply": "a", "matrix": [1, 2]}]}, "4 x 4"),
        ({"models": [{"ply": "a", "matrix": POSE, "gains": [1, 1]}]}, "gains must be 3 numbers"),
        ({"models": [{"ply": "a", "matrix": POSE, "gains": [1, 1, -1]}]}, "gains must be from 0"),
        ({"models": [{"ply": "a", "matrix": POSE, "gains": [1, 1, float("nan")]}]}, "gains has"),
        ({"models": [{"ply": "a", "matrix": POSE, "gains": ["a", 1, 1]}]}, "malformed"),
        ({"models": [{"ply": "a", "matrix": POSE, "density": 0}]}, "density must be"),
        ({"models": [{"ply": "a", "matrix": POSE, "density": 1.5}]}, "density must be"),
        ({"models": [{"ply": "a", "matrix": POSE, "density": float("nan")}]}, "density must be"),
        ({"models": [{"ply": "a", "matrix": POSE, "density": [1]}]}, "malformed"),
        *(
            ({"models": [{"ply": "a", "matrix": POSE, "object_index": wrong}]}, "object_index must")
            for wrong in (-1, 32768, 1.0, True, "1", None, [1])
        ),
    ],
)
def test_what_is_wrong_is_said(
    folder: Path, changes: dict[str, Any], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    ask(folder, **changes)
    assert text in fails(["render-frames", str(folder), "--once"], capsys)
    assert not list(folder.iterdir())


OTHERS = (
    "[1]",
    "{}",
    '{"rois": []}',
    '{"out": "a", "models": []}',
    '{"camera": 1, "models": 2}',
    "{",
)


@pytest.mark.parametrize("text", [*OTHERS, "{"])
def test_other_files_stay(folder: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A mistyped folder once lost all its JSON files."""
    (folder / "b.json").write_text(text)
    ask(folder)
    assert "b.json" in fails(["render-frames", str(folder), "--once"], capsys)
    assert [path.name for path in folder.iterdir()] == ["b.json"]
    assert (folder / "b.json").read_text() == text


def test_another_file_is_reported_once(folder: Path) -> None:
    heard: list[Event] = []
    (folder / "a.json").write_text("{}")
    ask(folder, "b")
    turns = iter(range(30))
    context = Context(emit=heard.append, should_stop=lambda: next(turns, None) is None)
    render_frames(RenderFrames(folder=folder), context)
    warned = [event for event in heard if isinstance(event, Message) and event.level == "warning"]
    assert len(warned) == 1 and "a.json is not a request" in warned[0].text
    assert [path.name for path in folder.iterdir()] == ["a.json"]


@pytest.mark.parametrize("inner", ["", "selection"])
def test_a_run_folder_is_refused(
    folder: Path, inner: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("manifest.json", "split.json", "selection/vase.json"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("{}")
    given = str(folder / inner)
    assert "files of the run" in fails(["render-frames", given, "--once"], capsys)


@pytest.mark.parametrize("inner", ["", "images", "sparse/0"])
def test_a_colmap_project_is_refused(
    folder: Path, inner: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_project(folder)
    assert "is a COLMAP project" in fails(["render-frames", str(folder / inner), "--once"], capsys)


def test_each_model_that_is_read_is_a_sign_of_life(folder: Path) -> None:
    """Blender ends an engine that is silent for long; large models take long to read."""
    heard: list[Event] = []
    second = folder.parent / "second.ply"
    second.write_bytes((folder.parent / "ball.ply").read_bytes())
    models = Models(print)
    for _ in range(2):  # the second time, nothing is read
        models.get([str(folder.parent / "ball.ply"), str(second)], Context(emit=heard.append))
    assert [(e.step, e.total) for e in heard if isinstance(e, Progress)] == [(1, 2), (2, 2)]


@pytest.mark.parametrize("out", ["/", "a\0b", "\ud800", 5])
def test_a_picture_needs_a_name(
    folder: Path, out: object, capsys: pytest.CaptureFixture[str]
) -> None:
    ask(folder, out=out)
    assert "a.json is malformed" in fails(["render-frames", str(folder), "--once"], capsys)


@pytest.mark.skipif(os.name != "posix", reason="makes a pipe")
@pytest.mark.parametrize("name", ["surfaces", "rays"])
def test_a_pipe_is_not_waited_for(
    folder: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    os.mkfifo(folder / "pipe")
    ask(folder, **{name: "pipe"})
    assert "Cannot read" in fails(["render-frames", str(folder), "--once"], capsys)


@pytest.mark.parametrize(
    "start", [b"PK\3\4", b"\x93NUMPY\1\0\1\0(", b"\x93NUMPY\1\0\xff\x0f" + b"-" * 4095]
)
def test_damaged_numbers_are_one_line(
    folder: Path, start: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "numbers.npy").write_bytes(start + bytes(200))
    ask(folder, surfaces="numbers.npy")
    assert "Cannot read" in fails(["render-frames", str(folder), "--once"], capsys)


def test_a_request_that_cannot_be_deleted_is_answered_once(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path) -> None:
        raise PermissionError(1, "Operation not permitted", str(path))

    out = ask(folder)
    monkeypatch.setattr(Path, "unlink", refuse)
    assert main(["render-frames", str(folder), "--once"]) == 0
    assert colour_file(out).exists() and list(folder.iterdir())


def test_the_end_of_its_folder_is_the_end(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    threading.Timer(0.2, folder.rmdir).start()
    assert "was deleted" in fails(["render-frames", str(folder)], capsys)


def test_a_folder_is_needed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "is not a folder" in fails(["render-frames", str(tmp_path / "none")], capsys)


def test_mattes_are_asked_for(folder: Path) -> None:
    """Two more files: the indices of the objects in each pixel, and their shares of it."""
    ball = str(folder.parent / "ball.ply")
    behind = np.eye(4)
    behind[:3, 3] = 1, 0, 2
    models = [
        {"ply": ball, "matrix": np.eye(4).tolist(), "object_index": 32767},
        {"ply": ball, "matrix": behind.tolist(), "object_index": 2},
    ]
    plain, asked = ask(folder, models=models), ask(folder, "b", models=models, mattes=True)
    samples = [{**sample, "models": models} for sample in sampled(folder, 0, 0)]
    blurred = ask(folder, "c", samples=samples, mattes=True)
    assert main(["render-frames", str(folder), "--once"]) == 0
    assert not index_file(plain).exists() and not share_file(plain).exists()
    assert colour_file(plain).read_bytes() == colour_file(asked).read_bytes()
    alpha = np.asarray(Image.open(colour_file(asked)))[..., 3] / 255
    for out in (asked, blurred):
        indices, shares = tiff_numbers(index_file(out)), tiff_numbers(share_file(out))
        assert indices[12, 14].tolist() == [32767, 2, 0] and indices[12, 24, 0] == 2
        np.testing.assert_allclose(shares.sum(axis=-1), alpha, atol=0.005)


def tiff_numbers(path: Path) -> np.ndarray[Any, Any]:
    """(24, 32, 3) of a TIFF, whose numbers are its end."""
    data = path.read_bytes()
    assert data[:4] == b"II*\0"
    return np.frombuffer(data[-24 * 32 * 12 :], "<f4").reshape(24, 32, 3)


def test_nothing_is_transparent_and_of_the_pictures_size(tmp_path: Path) -> None:
    out = tmp_path / "a0001"
    write_nothing(out, 30, 20)
    assert not index_file(out).exists() and not share_file(out).exists()
    write_nothing(out, 30, 20, mattes=True)
    for file in (depth_file(out), colour_file(out), index_file(out), share_file(out)):
        picture = np.asarray(Image.open(file))
        assert picture.shape == (20, 30, 4) and not picture.any()


def sampled(folder: Path, *eyes: float, **more: Any) -> list[dict[str, Any]]:
    """Samples of cameras that many units to the right."""
    poses = [[[1, 0, 0, -x], *POSE[1:]] for x in eyes]
    models = [{"ply": str(folder.parent / "ball.ply"), "matrix": np.eye(4).tolist()}]
    cameras = [{**CAMERA, "world_to_camera": pose} for pose in poses]
    return [{"camera": camera, "models": models, **more} for camera in cameras]


def test_samples_are_averaged_without_what_surfaces_hide(folder: Path) -> None:
    wall = np.array([[[-9, -9, -1], [9, -9, -1], [0, 18, -1]]], np.float32)
    np.save(folder.parent / "wall.npy", wall)
    both = sampled(folder, -1, 1)
    half = [both[0] | {"surfaces": "../wall.npy"}, both[1]]
    outs = [ask(folder, name, samples=s) for name, s in (("a", both), ("b", half))]
    assert main(["render-frames", str(folder), "--once"]) == 0
    blurred, hidden = (np.asarray(Image.open(colour_file(out)))[12, :, 3] for out in outs)
    assert blurred[8] == blurred[23] == pytest.approx(127, abs=2) and blurred[16] < 50
    assert hidden[8] == blurred[8] and hidden[23] < 2
    depth = np.asarray(Image.open(depth_file(outs[0])))
    assert depth[12, 8] == pytest.approx(-4, abs=0.1) and depth.max() < 0


@pytest.mark.parametrize(
    ("samples", "reason"),
    [
        ([], "samples must be from 1 to"),
        ([{}], "is malformed ('camera')"),
        ([1], "is malformed"),
        ({"a": 1}, "is malformed"),
    ],
)
def test_malformed_samples_are_one_line(
    folder: Path, samples: Any, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    ask(folder, samples=samples)
    assert reason in fails(["render-frames", str(folder), "--once"], capsys)


@pytest.mark.parametrize("content", [b"", b"text", b"\x93NUMPY\x01\x00\x06\x00{}    "])
def test_surfaces_that_cannot_be_read_are_one_line(
    folder: Path, content: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder.parent / "wall.npy").write_bytes(content)
    ask(folder, samples=sampled(folder, 0, surfaces="../wall.npy"))
    assert "Cannot read" in fails(["render-frames", str(folder), "--once"], capsys)
    for wrong in (np.zeros((2, 3, 3)), np.zeros((2, 9), np.float32), np.full((1, 3, 3), np.nan)):
        np.save(folder.parent / "wall.npy", wrong.astype(wrong.dtype if wrong.size != 9 else "f4"))
        ask(folder, samples=sampled(folder, 0, surfaces="../wall.npy"))
        assert "wall.npy has" in fails(["render-frames", str(folder), "--once"], capsys)


def test_rays_make_a_panorama(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of the picture's size, and not among samples."""
    rays = np.zeros((24, 32, 3), np.float32)
    rays[:, :16, 2], rays[:, 16:, 2] = 1, -1
    np.save(folder.parent / "rays.npy", rays)
    out = ask(folder, rays="../rays.npy")
    assert main(["render-frames", str(folder), "--once"]) == 0
    alpha = np.asarray(Image.open(colour_file(out)))[..., 3]
    assert alpha[:, :16].min() > 250 and alpha[:, 16:].max() == 0
    np.save(folder.parent / "rays.npy", rays[:-1])
    ask(folder, rays="../rays.npy")
    assert "rays.npy has no rays" in fails(["render-frames", str(folder), "--once"], capsys)
    ask(folder, samples=sampled(folder, 0, rays="../rays.npy"))
    assert "samples have no rays" in fails(["render-frames", str(folder), "--once"], capsys)
