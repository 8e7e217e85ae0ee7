"""Files of other programs: what is written comes back, as readers of each have it."""

from __future__ import annotations

import json
import os
import re
import shutil
import struct
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from roigs_engine import machine
from roigs_engine.cli import main
from roigs_engine.errors import ConfigError, EngineError, RunFolderError, Stopped
from roigs_engine.exchange import formats, gltf
from roigs_engine.exchange.arrays import UP, turn
from roigs_engine.exchange.transform import moved
from roigs_engine.formats.splat_ply import read_ply, write_ply
from tests.engine.exchange.format_cases import LEAST, READABLE, TOOL, arrays, needed, picture, psnr


@pytest.mark.parametrize("form", READABLE, ids=lambda form: form.suffix)
def test_what_is_written_comes_back(form: formats.FileFormat, tmp_path: Path) -> None:
    needed(form)
    path = tmp_path / f"model{form.suffix}"
    formats.write(path, arrays())
    back = formats.read(path)
    assert len(back["means"]) == 400
    assert psnr(picture(dict(back)), picture(arrays())) > LEAST.get(form.suffix, 90.0)


@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("form", READABLE, ids=lambda form: form.suffix)
def test_fewer_degrees(form: formats.FileFormat, degree: int, tmp_path: Path) -> None:
    needed(form)
    bands = (degree + 1) ** 2
    kept = 1 if form.suffix == ".splat" else bands
    path, values = tmp_path / f"model{form.suffix}", arrays()
    formats.write(path, {**values, "sh": values["sh"][:, :bands]})
    assert formats.read(path)["sh"].shape == (400, kept, 3)


@pytest.mark.parametrize("form", READABLE, ids=lambda form: form.suffix)
def test_there_and_back_stands_upright(form: formats.FileFormat, tmp_path: Path) -> None:
    """`convert` turns a model into the frame of the format, and back."""
    needed(form)
    write_ply(tmp_path / "in.ply", arrays())
    made, back = tmp_path / f"made{form.suffix}", tmp_path / "back.ply"
    assert main(["convert", str(tmp_path / "in.ply"), str(made)]) == 0
    if form.up == "y":
        inside = np.median(formats.read(made)["means"][:, 1])
        assert inside == pytest.approx(-np.median(arrays()["means"][:, 1]), abs=0.01)
    assert main(["convert", str(made), str(back)]) == 0
    least = LEAST.get(form.suffix, 90.0)
    assert psnr(picture(read_ply(back)), picture(arrays())) > least


def test_another_axis_points_up(tmp_path: Path) -> None:
    write_ply(tmp_path / "in.ply", arrays())
    out = tmp_path / "out.ply"
    assert main(["convert", str(tmp_path / "in.ply"), str(out), "--up", "z"]) == 0
    x, y, z = arrays()["means"].T
    np.testing.assert_allclose(read_ply(out)["means"], np.column_stack((x, z, -y)), atol=1e-5)


@pytest.mark.parametrize("before", UP)
@pytest.mark.parametrize("after", UP)
def test_turning_is_a_rotation(before: str, after: str) -> None:
    there = turn(before, after)
    assert np.linalg.det(there[:3, :3]) == pytest.approx(1)
    assert (there @ turn(after, before) == np.eye(4)).all()
    pointing = {"-y": (0, -1, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
    assert (there[:3, :3] @ pointing[before] == pointing[after]).all()


def test_only_what_is_in_a_box(tmp_path: Path) -> None:
    write_ply(tmp_path / "in.ply", arrays())
    rois = [{"name": "half", "min": [0, -9, -9], "max": [9, 9, 9]}]
    (tmp_path / "rois.json").write_text(json.dumps({"rois": rois}))
    out = tmp_path / "out.ply"
    boxes = ["--rois", str(tmp_path / "rois.json"), "--box", "half"]
    assert main(["convert", str(tmp_path / "in.ply"), str(out), *boxes]) == 0
    assert (read_ply(out)["means"][:, 0] >= 0).all()


PLACE = np.eye(4)
PLACE[:3, :3] = 0.5 * Rotation.from_rotvec([0.3, -0.2, 0.4]).as_matrix()
PLACE[:3, 3] = 0.1, -0.2, 0.3


def glb_with(path: Path, change: Any) -> None:
    """A GLB whose JSON is changed."""
    raw = path.read_bytes()
    size = int.from_bytes(raw[12:16], "little")
    record = json.loads(raw[20 : 20 + size])
    change(record)
    text = json.dumps(record).encode()
    text += b" " * (-len(text) % 4)
    rest = raw[20 + size :]
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    path.write_bytes(head + text + rest)


def nodes(record: Any) -> None:
    """The mesh's node is turned and scaled, its parent moved."""
    turned = Rotation.from_matrix(2 * PLACE[:3, :3]).as_quat().tolist()
    child = {"mesh": 0, "rotation": turned, "scale": [0.5] * 3}
    moved = np.eye(4)
    moved[:3, 3] = PLACE[:3, 3]
    parent = {"children": [0], "matrix": moved.T.reshape(-1).tolist()}
    record["nodes"] = [child, parent]
    record["scenes"] = [{"nodes": [1]}]


def test_a_gltf_node_moves_its_gaussians(tmp_path: Path) -> None:
    pytest.importorskip("pygltflib")
    path, values = tmp_path / "a.glb", arrays()
    formats.write(path, values)
    glb_with(path, nodes)
    assert psnr(picture(formats.read(path)), picture(moved(values, PLACE))) > 60


@pytest.mark.parametrize(
    ("nodes", "why"),
    [
        ([{"children": [1, 1]}, {"mesh": 0}], "circle"),
        ([{"mesh": 0, "children": [1]}, {"children": [0]}], "circle"),
        ([{"mesh": 0, "scale": [1, 0, 1]}], "flattens"),
        ([{"mesh": 0, "matrix": [1, 2]}], "not a whole glTF"),
        ([{"mesh": 0, "rotation": [0, 0, 0, 0]}], "not a whole glTF"),
        ([{"mesh": 0, "translation": [float("nan"), 0, 0]}], "none of space"),
    ],
)
def test_gltf_nodes_that_make_no_sense_are_one_line(nodes: Any, why: str, tmp_path: Path) -> None:
    pytest.importorskip("pygltflib")
    formats.write(tmp_path / "a.glb", arrays())
    glb_with(tmp_path / "a.glb", lambda record: record.update(nodes=nodes))
    with pytest.raises(RunFolderError, match=why):
        formats.read(tmp_path / "a.glb")


def test_openusd_transforms_and_up_axis_move_the_gaussians(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Gf, Usd, UsdGeom

    path, values = tmp_path / "a.usda", arrays()
    formats.write(path, values)
    stage = Usd.Stage.Open(str(path))
    prim = UsdGeom.Xformable(stage.GetDefaultPrim())
    prim.AddTransformOp().Set(Gf.Matrix4d(PLACE.T.tolist()))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.GetRootLayer().Save()
    assert psnr(picture(formats.read(path)), picture(moved(values, PLACE))) > 60
    assert np.allclose(formats.frame(path), turn("z", "y"))


def test_a_validator_of_gltf_finds_nothing(tmp_path: Path) -> None:
    """npm's gltf-validator, where NODE_PATH has it."""
    pytest.importorskip("pygltflib")
    there = [Path(p, "gltf-validator") for p in os.environ.get("NODE_PATH", "").split(os.pathsep)]
    if shutil.which("node") is None or not any(path.is_dir() for path in there):
        pytest.skip("no gltf-validator in NODE_PATH")
    formats.write(tmp_path / "a.glb", arrays())
    script = (
        "require('gltf-validator').validateBytes(new Uint8Array(require('fs').readFileSync("
        "process.argv[1]))).then(r => console.log(JSON.stringify(r.issues)))"
    )
    command = ["node", "-e", script, str(tmp_path / "a.glb")]
    found = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    # It does not know the extension yet, so not the names of its attributes either.
    strange = {"UNSUPPORTED_EXTENSION", "MESH_PRIMITIVE_INVALID_ATTRIBUTE"}
    wrong = [message for message in found["messages"] if message["code"] not in strange]
    assert not wrong
    others = [m for m in found["messages"] if gltf.NAME not in json.dumps(m)]
    assert not others


def test_splat_files_have_32_bytes_each(tmp_path: Path) -> None:
    path = tmp_path / "model.splat"
    formats.write(path, arrays())
    raw = np.frombuffer(path.read_bytes(), np.float32).reshape(400, 8)
    size = np.sort(arrays()["means"][:, 0])
    np.testing.assert_array_equal(np.sort(raw[:, 0]), size)


def test_splat_files_are_read_back(tmp_path: Path) -> None:
    path, values = tmp_path / "model.splat", arrays()
    formats.write(path, values)
    found = formats.read(path)
    before, after = np.argsort(values["means"][:, 0]), np.argsort(found["means"][:, 0])
    for name, near in (("means", 0), ("log_scales", 1e-5), ("logit_opacities", 0.3)):
        difference = np.abs(found[name][after] - values[name][before])
        assert difference.max() <= near, name
    colours = [0.5 + 0.28209479 * v["sh"][o, 0] for v, o in ((values, before), (found, after))]
    np.testing.assert_allclose(colours[1], np.clip(colours[0], 0, 1), atol=0.003)
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(RunFolderError, match="no multiple of 32"):
        formats.read(path)


def test_a_compressed_ply_of_another_name(tmp_path: Path) -> None:
    pytest.importorskip("gsply")
    formats.write(tmp_path / "a.compressed.ply", arrays())
    (tmp_path / "a.compressed.ply").rename(tmp_path / "b.ply")
    assert len(formats.read(tmp_path / "b.ply")["means"]) == 400


def test_web_pages_are_only_written(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        formats.read(tmp_path / "a.html")


def test_spz_keeps_what_is_far_away_if_it_can(tmp_path: Path) -> None:
    pytest.importorskip("gsply")
    values = arrays()
    values["means"][0] = (50, 0, 0)
    formats.write(tmp_path / "a.spz", values)
    assert formats.read(tmp_path / "a.spz")["means"][:, 0].max() == pytest.approx(50, abs=0.01)
    values["means"][0] = (1e6, 0, 0)
    formats.write(tmp_path / "a.spz", values)
    assert len(formats.read(tmp_path / "a.spz")["means"]) == 399


def test_what_a_format_cannot_hold_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("gsply")
    far = arrays()
    far["means"] = far["means"].astype(np.float64) + np.array((4e6, 5e6, 0))
    with pytest.raises(ConfigError, match="too far from the origin"):
        formats.write(tmp_path / "far.spz", far)
    tiny = arrays()
    tiny["log_scales"] -= 20
    with pytest.raises(ConfigError, match="too small or too large"):
        formats.write(tmp_path / "tiny.spz", tiny)
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_drawn_is_left_out(tmp_path: Path) -> None:
    pytest.importorskip("pygltflib")
    values = arrays()
    values["means"][0, 0], values["quats"][1] = np.nan, 0
    formats.write(tmp_path / "a.glb", values)
    assert len(formats.read(tmp_path / "a.glb")["means"]) == 398


def test_sog_keeps_a_few_large_gaussians_large(tmp_path: Path) -> None:
    """Those of a background are few; codes by quantiles made them up to a third smaller."""
    needed(formats.format_of(tmp_path / "a.sog"))
    values = arrays(4000)
    values["sh"] = values["sh"][:, :1]  # a palette takes long
    random = np.random.default_rng(0)
    values["log_scales"] = random.normal(-6, 0.7, (4000, 3)).astype(np.float32)
    values["log_scales"][:20] = random.uniform(-2, 3, (20, 3))
    formats.write(tmp_path / "a.sog", values)
    large = np.sort(formats.read(tmp_path / "a.sog")["log_scales"].max(axis=1))[-20:]
    wanted = np.sort(values["log_scales"].max(axis=1))[-20:]
    assert np.abs(large - wanted).max() < 0.03


def test_sog_of_equal_colours(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    needed(formats.format_of(tmp_path / "a.sog"))
    values = arrays(400)
    values["sh"][:, 1:] = 0.25
    formats.write(tmp_path / "a.sog", values)
    assert np.abs(formats.read(tmp_path / "a.sog")["sh"][:, 1:] - 0.25).max() < 0.01
    assert not recwarn.list


@pytest.mark.parametrize(("suffix", "least"), [(".sog", 20), (".spz", 3)])
def test_a_stop_is_seen_between_the_parts(tmp_path: Path, suffix: str, least: int) -> None:
    path = tmp_path / f"a{suffix}"
    needed(formats.format_of(path))
    calls: list[int] = []
    formats.write(path, arrays(400), lambda: calls.append(1))
    assert len(calls) >= least
    path.unlink()

    def stop() -> None:
        calls.pop()
        if not calls:
            raise Stopped

    with pytest.raises(Stopped):
        formats.write(path, arrays(400), stop)
    assert not list(tmp_path.iterdir())


def test_a_missing_package_is_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def missing(name: str, package: str | None = None) -> None:
        raise ImportError(f"No module named '{name}'")

    monkeypatch.setattr(machine, "import_module", missing)
    for suffix, package in ((".spz", "gsply"), (".glb", "pygltflib"), (".usdc", "usd-core")):
        with pytest.raises(EngineError, match=f"needs {package}, which is not installed") as caught:
            formats.write(tmp_path / f"a{suffix}", arrays())
        assert f"pip install {package}" in str(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.cold
@pytest.mark.parametrize("form", READABLE, ids=lambda form: form.suffix)
def test_damaged_files_are_one_line(form: formats.FileFormat, tmp_path: Path) -> None:
    needed(form)
    path = tmp_path / f"model{form.suffix}"
    formats.write(path, arrays())
    whole = path.read_bytes()
    # Half of a .splat is one with half as many Gaussians.
    cuts = {0, 3, 20, len(whole) // 2 + (form.suffix == ".splat"), len(whole) - 9}
    if form.module == "usd":  # each takes a process
        cuts -= {3, 20}
    if form.suffix == ".usdz":  # USD reads one without the ZIP's last record
        cuts -= {len(whole) - 9}
    for cut in sorted(cuts):
        path.write_bytes(whole[:cut])
        with pytest.raises(RunFolderError) as caught:
            formats.read(path)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(RunFolderError):
        formats.read(tmp_path / f"gone{form.suffix}")


def axis_up(suffix: str) -> list[str]:
    """The option for a file that stands upright there: from 3 on it takes SPZ as a PLY."""
    if suffix != ".spz":
        return []
    said = subprocess.run([str(TOOL), "--version"], capture_output=True, text=True, check=True)
    version = re.search(r"v(\d+)\.", said.stdout + said.stderr)
    return ["--up=-y"] if version and int(version[1]) >= 3 else []


@pytest.mark.skipif(TOOL is None, reason="needs npm's @playcanvas/splat-transform")
@pytest.mark.parametrize("suffix", [".compressed.ply", ".spz", ".sog", ".splat"])
def test_another_program_reads_it(suffix: str, tmp_path: Path) -> None:
    write_ply(tmp_path / "in.ply", arrays())
    made, back = tmp_path / f"made{suffix}", tmp_path / "back.ply"
    up = axis_up(suffix)
    assert main(["convert", str(tmp_path / "in.ply"), str(made), *up]) == 0
    subprocess.run([str(TOOL), "-q", "-w", made, back], check=True, capture_output=True)
    assert psnr(picture(read_ply(back)), picture(arrays())) > LEAST[suffix]


@pytest.mark.parametrize("suffix", [".sog", ".usdz"])
def test_an_archive_has_the_same_bytes_each_time(suffix: str, tmp_path: Path) -> None:
    needed(formats.format_of(Path(f"a{suffix}")))
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    formats.write(first, arrays())
    time.sleep(2.1)  # archives note times in steps of two seconds
    formats.write(second, arrays())
    assert first.read_bytes() == second.read_bytes()
